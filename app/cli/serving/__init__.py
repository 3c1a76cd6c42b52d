"""The processes of a site: the dashboard, its workers, their start and their end."""
