"""The message of a notification: its texts, its attachment, its link."""
