"""The configuration file, changed in the browser: a review, versions, and the way back."""
