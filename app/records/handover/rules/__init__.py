"""Pure rules: which shift a moment is in, and which moment of it a clock shows."""
