"""The live state: the newest reading of every unit with its age, and its presentation to pages and
programs."""
