"""The handbook and the reference of the API."""

from __future__ import annotations

from app.core.help import pages
from app.core.help.handbook import Handbook
from app.core.web.rendering.assets import docs_dir
from app.feature import Feature, Services


def make(services: Services) -> None:
    services.add(Handbook(docs_dir()))


FEATURE = Feature(make, (pages.router,))
