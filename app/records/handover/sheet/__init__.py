"""The sheet of a shift: what the store holds of it, and the document that it makes."""
