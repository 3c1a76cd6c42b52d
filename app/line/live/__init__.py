"""The live state: the newest reading of every unit with its age, and what pages and programs are sent of
it."""
