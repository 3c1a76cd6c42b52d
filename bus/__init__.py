"""The wire: one process per serial port polls, schedules, retries, verifies, stages and broadcasts."""
