"""Who is notified of what, when, and how often it is tried. Pure: the time is passed in."""
