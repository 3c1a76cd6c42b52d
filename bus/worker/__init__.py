"""The worker of one bus and its link to the app, with what it keeps while the app is away."""
