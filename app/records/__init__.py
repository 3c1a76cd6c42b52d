"""Records that people read and receive: reports, the shift handover, notification."""
