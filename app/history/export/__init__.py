"""Any span of history as a file."""
