"""Who did what, with its fate: append-only, each entry chained by hash to the one before."""
