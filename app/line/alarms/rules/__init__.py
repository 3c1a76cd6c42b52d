"""The rules of alarms: their states, their detection and their figures. Pure: the time is passed in."""
