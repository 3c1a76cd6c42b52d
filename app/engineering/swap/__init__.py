"""Replacing a failed unit by a spare, step by step, until the spare is verified to equal it."""
