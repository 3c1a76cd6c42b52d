"""Backups of everything that a server keeps, each night, and the alarm where one is missing."""
