"""The proof that the log was not altered: chains, keys, and heads outside the store."""
