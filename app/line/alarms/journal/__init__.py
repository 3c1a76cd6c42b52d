"""Alarms at rest, the journal of their transitions, and its figures."""
