"""The state of the server on one page: what guards its records, since when, and what to do about it."""
