"""What a configuration meets on this machine, each part by its own examination."""
