"""Who did what, with its outcome: append-only, each entry chained by hash to the one before."""
