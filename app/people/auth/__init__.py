"""Who: users, roles, sessions, tokens. Everything is refused that is not allowed by name."""
