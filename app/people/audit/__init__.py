"""The audit log, which holds who did what with what outcome: append-only, each entry chained by hash to the
one before."""
