"""Which server is the home of each bus, as far as this one knows it."""

from __future__ import annotations

from app.feature import Feature, Services
from app.home.homes import Homes


def make(services: Services) -> None:
    """None is here yet where servers share the store."""
    server = services.settings.server
    services.add(Homes(server.id, server.own_url, is_shared=False))


FEATURE = Feature(make)
