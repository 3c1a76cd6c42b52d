"""The lines of this server and its peers in short: a page of all, the wallboard, ``GET /sites``."""
