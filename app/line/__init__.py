"""The drive line: its live state, history, alarms and commands."""
