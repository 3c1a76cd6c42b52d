"""Parameter sets: store, compare, restore, verify."""
