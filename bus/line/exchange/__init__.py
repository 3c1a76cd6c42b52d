"""One request and its response: window, late responses, retries."""
