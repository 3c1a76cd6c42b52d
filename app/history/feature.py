"""History: readings stored, queried and exported."""

from __future__ import annotations

import asyncio
from functools import partial

from app.database import Database
from app.feature import Feature, Services
from app.history import api as routes
from app.history import pages
from app.history.acts import ACTS
from app.history.service import History
from app.history.views import TrendViews
from app.web.rendering.assets import Assets
from app.web.rendering.templating import Templates


def make(services: Services) -> None:
    lifespan, language = services.lifespan, services.settings.site.language
    services.add(TrendViews(services[Database]))
    history = services.add(History(services.settings))

    async def start() -> None:
        history.start()

    lifespan.add("history", history.inspect_daily, start=start, end=partial(asyncio.to_thread, history.close))
    warm = partial(pages.warm, history, services[Templates], services[Assets], language)
    lifespan.add("warming", once=warm)


FEATURE = Feature(make, (routes.router, pages.router), ACTS)
