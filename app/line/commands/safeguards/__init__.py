"""Limits, command blocks and control: what an operator sets so that commands are refused."""
