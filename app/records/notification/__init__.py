"""Notification of people and programs about alarms: rules, duty rosters and escalation, with retries."""
