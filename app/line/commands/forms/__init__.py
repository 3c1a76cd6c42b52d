"""What the pages with a form share: context of the request, review, result."""
