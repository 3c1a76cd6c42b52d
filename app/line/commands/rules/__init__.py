"""What may be sent, and which setpoints a unit may get. Pure."""
