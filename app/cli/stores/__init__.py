"""Stores as files: copied, restored."""
