"""Differences of sets and units, and the drift of units from their golden sets."""
