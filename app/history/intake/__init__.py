"""From updates to disk: one thread writes, packs and removes by age."""
