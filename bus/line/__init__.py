"""A serial line and its units: which request is next, the state of each unit, the proof of writes."""
