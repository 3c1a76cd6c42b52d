"""Which address gets which notice, when, and how often it is tried. Pure: the time is passed in."""
