"""The live state: the newest reading of every unit, with its age, and the subscribers of its changes."""
