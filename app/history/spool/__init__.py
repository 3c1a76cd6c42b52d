"""What was taken in while the database cannot be reached: on this server's disk until it follows. Imported
only where history is in a database server."""
