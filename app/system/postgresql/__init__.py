"""The plant's database: stored data is copied there as plain rows; nothing is read from it."""
