"""The machine room: configuration, backup, metrics, the plant's database, peers."""
