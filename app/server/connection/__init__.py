"""A connection: accepted, counted, spoken by uvicorn within bounds, and watched to its end."""
