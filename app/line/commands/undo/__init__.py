"""Undo: what a person's commands changed, and the commands back to what was there before."""
