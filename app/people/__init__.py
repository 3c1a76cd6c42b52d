"""Who uses the site, and what they did."""
