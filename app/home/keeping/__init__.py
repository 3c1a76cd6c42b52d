"""What holds the homes of this server: renews, takes and gives up, and runs what belongs to a bus."""
