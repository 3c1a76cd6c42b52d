"""Ways of sending: mail, webhook, apprise."""
