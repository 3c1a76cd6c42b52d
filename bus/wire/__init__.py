"""The bytes of the wire and their meaning: frames, commands, one exchange, words. No clock, no I/O."""
