"""From what is observed of units, buses and the site to transitions of alarms."""
