"""The present state over HTTP."""
