"""The connected browsers: what each gets, how often, over which socket."""
