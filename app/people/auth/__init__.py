"""Users, roles, sessions and tokens. Everything that is not allowed by name is refused."""
