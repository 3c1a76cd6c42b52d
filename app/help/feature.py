"""The handbook and the reference of the API."""

from __future__ import annotations

from app.feature import Feature, Services
from app.help import pages
from app.help.handbook import Handbook
from app.web.rendering.assets import docs_dir


def make(services: Services) -> None:
    services.add(Handbook(docs_dir()))


FEATURE = Feature(make, (pages.router,))
