"""From a command request to its result: recorded, sent once, followed to one outcome."""
