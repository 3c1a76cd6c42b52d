"""Parameter sets: stored, compared, restored, verified."""
