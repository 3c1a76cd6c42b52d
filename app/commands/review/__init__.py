"""What a review shows of a command before it is confirmed. Pure."""
