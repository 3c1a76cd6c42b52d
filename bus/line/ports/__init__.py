"""The kinds of port, each opened and used in its own way; ``bus.line.transport`` opens the right one."""
