"""What people read and are told: reports, the shift handover, notification."""
