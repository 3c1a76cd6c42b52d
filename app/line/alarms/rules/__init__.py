"""The states of an alarm and what changes them. Pure: the time is passed in."""
