"""One serial line and its units: which request is next, what is known, what is verified; all the waiting."""
