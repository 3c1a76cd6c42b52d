"""Commands that need a port or the bytes of one, and no site."""
