"""What an alarm would have done: its rules over stored history."""
