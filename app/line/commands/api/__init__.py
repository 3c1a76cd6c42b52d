"""The commands over HTTP."""
