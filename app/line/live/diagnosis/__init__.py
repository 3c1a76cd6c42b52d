"""The abnormal conditions of a line and their causes. Pure."""
