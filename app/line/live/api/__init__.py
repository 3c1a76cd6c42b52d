"""The live state over HTTP."""
