"""The present state of every bus and unit, and what follows from a reading."""
