"""What touches the server and the framework below the app: addresses, protocols, bounds."""
