"""The procedures that carry out commands and read them back. Pure."""
