"""Shift hand-over: notes of a shift, and its sheet."""
