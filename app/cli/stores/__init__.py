"""Stores as files: copied, restored, moved to another engine."""
