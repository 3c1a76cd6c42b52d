"""Shift hand-over: notes, pictures, the sheet, and who signed it."""

from __future__ import annotations

import asyncio
from functools import partial

from app.core.database import Database
from app.core.web.assets import Assets
from app.core.web.templating import Templates
from app.feature import Feature, Services
from app.line.alarms.line_alarms import LineAlarms
from app.people.audit.log import EventLog
from app.people.auth.sign_in import SignIn
from app.records.handover import api, pages
from app.records.handover.notes import PictureStore
from app.records.handover.service import Handover, SheetDocuments, Signing
from app.records.handover.signatures import ACTS


def make(services: Services) -> None:
    settings, database, events = services.settings, services[Database], services[EventLog]
    pictures = services.add(PictureStore(settings.server.data, settings.shift.pictures_mb))
    services.lifespan.add("pictures", end=partial(asyncio.to_thread, pictures.close))
    handover = services.add(Handover(settings, database, events, pictures))
    templates, assets = services[Templates], services[Assets]
    documents = services.add(SheetDocuments(templates, assets, services[LineAlarms], pictures))
    services.add(Signing(handover, database, events, services[SignIn], documents.page))


FEATURE = Feature(make, (api.router, pages.router), ACTS)
