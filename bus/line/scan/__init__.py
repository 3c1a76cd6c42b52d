"""Which addresses respond, found out by reading only."""
