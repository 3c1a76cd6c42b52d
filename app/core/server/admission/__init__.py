"""The admission of requests: whose turn it is, and what is refused before the app sees it."""
