"""Signing in: by password, by PIN, as the first admin, or while the database is away."""
