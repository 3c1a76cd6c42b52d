"""Shift handover: the notes of a shift, and its sheet."""
