"""A store that is a schema of a PostgreSQL database. Imported only where one is configured."""
