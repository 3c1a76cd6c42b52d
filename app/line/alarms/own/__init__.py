"""The site's own alarms: defined, added, changed and removed."""
