"""Entries that are logged on this machine while the database is away, and follow into the audit log."""
