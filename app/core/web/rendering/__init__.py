"""What a page is made of: templates, static files, and what its head shows."""
