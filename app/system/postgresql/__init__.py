"""The plant's database: what is stored is copied there as plain rows, and nothing is read from it."""
