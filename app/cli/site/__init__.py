"""What a site is and has recorded, read whether its dashboard runs or not."""
