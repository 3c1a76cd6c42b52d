"""Stored readings: every one kept, downsampled by age, and drawn over any span."""
