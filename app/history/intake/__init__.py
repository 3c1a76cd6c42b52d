"""Writes updates to the disk: one thread writes, packs and removes by age."""
