"""Simulated DIGIMAX IV units behind a pseudo-terminal or a TCP port, true to the byte time."""
