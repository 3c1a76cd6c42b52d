"""The account of a request, and what it may do at this moment."""
