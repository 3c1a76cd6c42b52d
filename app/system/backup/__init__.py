"""Backups of everything that a server keeps: written, thinned and read."""
