"""What is abnormal, and why. Pure."""
