"""The lines of this server and of its peers in short: a page of all, the wallboard and ``GET /sites``."""
