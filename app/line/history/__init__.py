"""Stored readings: every reading at first, downsampled by age, and drawn over any span."""
