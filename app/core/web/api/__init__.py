"""What every route of the API has in common, and the OpenAPI document."""
