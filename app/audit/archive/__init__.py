"""Old events, moved from the store into files: a file for each month, and the proof across them."""
