"""What carries out a command and reads it back, as pure procedures."""
