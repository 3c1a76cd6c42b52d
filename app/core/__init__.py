"""The parts on which every feature stands: store, web, server, texts, help and search."""
