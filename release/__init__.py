"""``make release``: what people install, from one commit, twice the same bytes."""
