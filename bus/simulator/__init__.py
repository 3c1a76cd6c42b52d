"""Simulated DIGIMAX IV units behind a pseudo-terminal or a TCP port, with the timing of each byte."""
