"""Backups of all data that a server keeps: write, thin out, read."""
