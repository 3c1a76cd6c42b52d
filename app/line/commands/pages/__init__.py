"""The pages that send commands."""
