"""Copies the stores of a site to another engine or another place, while a server uses them or not."""
