"""Notification of people and programs of alarms: by rule, duty roster and escalation, with retries."""
