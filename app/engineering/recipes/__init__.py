"""Setpoint recipes: all setpoints for one product, loaded as one change."""
