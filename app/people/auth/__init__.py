"""Users, roles, sessions and tokens. What is not allowed by name is refused."""
