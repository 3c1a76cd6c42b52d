"""What an administrator sets up: configuration, accounts, certificates, the service."""
