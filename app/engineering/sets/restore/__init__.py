"""Restores: planned and ordered by pure rules, carried out row by row, shown and stored."""
