"""Signing in: by password, by PIN, or as the first admin."""
