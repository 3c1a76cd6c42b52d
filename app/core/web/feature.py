"""Templates, static files, and the description of the API."""

from __future__ import annotations

from app.core.web import api as schema
from app.core.web import pages
from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.routes import Turns
from app.core.web.templating import Templates
from app.feature import Feature, Services


def make(services: Services) -> None:
    settings = services.settings
    services.add(Turns())
    assets = services.add(Assets(static_dir()))
    services.add(
        Templates(
            templates_dir(),
            assets,
            settings.site,
            demo=services.demo,
            kept_in=settings.server.data / "compiled",
            page_digest=settings.page_digest,
        )
    )


FEATURE = Feature(make, (pages.router, schema.router))
