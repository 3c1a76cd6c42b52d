"""What was asked: checked before anything is sent, sent once, followed to its one fate."""
