"""A line without drives: simulated units, and a site that shows them."""
