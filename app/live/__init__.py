"""What is now: the newest word of every unit, with its age, and who is told of a change."""
