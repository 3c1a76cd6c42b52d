"""The serial port, whatever carries it."""
