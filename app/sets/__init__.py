"""Parameter sets: stored, compared, restored, proven."""
