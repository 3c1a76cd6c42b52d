"""The state as the texts that a page shows. Pure."""
