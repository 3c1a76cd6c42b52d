"""Checks before a route reads a request: origin, size, age, account, turn."""
