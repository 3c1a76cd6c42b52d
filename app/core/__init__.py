"""What every feature stands on: store, web, server, texts, help and search."""
