"""History: readings stored, queried and exported."""

from __future__ import annotations

import asyncio
from functools import partial

from app.core.database import Database
from app.core.web.assets import Assets
from app.core.web.templating import Templates
from app.feature import Feature, Services
from app.line.history import api, pages
from app.line.history.pages import ACTS, TrendViews
from app.line.history.service import History


def make(services: Services) -> None:
    lifespan, language = services.lifespan, services.settings.site.language
    services.add(TrendViews(services[Database]))
    settings = services.settings
    history = services.add(
        History(
            settings.server.data, settings.bus, settings.history, settings.site.zone, settings.shift.minutes
        )
    )

    async def start() -> None:
        history.start()

    lifespan.add("history", start=start, end=partial(asyncio.to_thread, history.close))
    warm = partial(pages.warm, history, services[Templates], services[Assets], language)
    lifespan.add("warming", once=warm)


FEATURE = Feature(make, (api.router, pages.router), ACTS)
