"""The connections of clients: counted, bounded, given to uvicorn, and watched to their end."""
