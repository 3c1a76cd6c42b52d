"""The people of the site, and what they did."""
