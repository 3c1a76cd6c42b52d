"""Passing a request on to the home of its bus, with proof of who passes it on."""
