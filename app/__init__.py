"""People and time: pages, API, users, history, events. Never imports how bytes travel."""
