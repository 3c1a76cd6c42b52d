"""Hosts to compare with. Each is a process: ``python -m benchmarks.peers.NAME PORT UNITS``."""
