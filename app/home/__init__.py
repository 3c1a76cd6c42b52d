"""Which server is the home of a bus: the lease on it, its epoch, and what runs while it is held."""
