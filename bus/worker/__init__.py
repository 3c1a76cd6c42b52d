"""One bus and its link to the app: what goes up, what comes down, and what is kept while the app is away."""
