"""The spans of reports. Pure."""
