"""Whose request is next."""
