"""The abnormal conditions, one row each: read by the live state, the alarms, the screen."""
