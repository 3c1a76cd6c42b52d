"""Commands: checked before anything is sent, sent once, followed to exactly one result."""
