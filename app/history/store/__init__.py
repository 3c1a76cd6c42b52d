"""The history store: its rows, and how damage is found, repaired and salvaged."""
