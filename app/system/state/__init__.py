"""The page of the server's state: the safeguards of its records, their last times, the next actions."""
