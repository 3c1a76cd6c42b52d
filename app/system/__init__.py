"""The operation of the server: configuration, backup, metrics, the plant's systems, peers."""
