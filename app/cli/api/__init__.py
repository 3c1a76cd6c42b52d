"""Commands that use a running dashboard by its HTTP API."""
