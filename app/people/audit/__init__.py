"""The audit log, which records who did what with what outcome: append-only, each entry chained by hash to the
one before."""
