"""The handbook of Lineside, and the reference of its API, as pages of the dashboard."""
