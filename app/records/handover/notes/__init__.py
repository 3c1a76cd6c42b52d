"""Notes of a shift, with their pictures."""
