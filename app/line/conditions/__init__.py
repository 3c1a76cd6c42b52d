"""The abnormal conditions, one row each, which the live state, the alarms and the screen read."""
