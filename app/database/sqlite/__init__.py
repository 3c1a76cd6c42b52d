"""A store of SQLite: its connections, its migrations, the disk space kept for it."""
