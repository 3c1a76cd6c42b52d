"""All lines of all servers: a summary of each, once a second, in the memory of every server."""
