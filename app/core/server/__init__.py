"""The server below the app: addresses, connections, bounds, TLS."""
