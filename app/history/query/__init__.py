"""Reads the points of a chart from the store."""
