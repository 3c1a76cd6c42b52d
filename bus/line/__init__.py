"""One serial line and its units: who is asked next, what is known, what is proven; all the waiting."""
