"""Setpoint recipes: the setpoints of a product, loaded as one change."""
