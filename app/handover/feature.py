"""Shift hand-over: notes, pictures, the sheet, and who signed it."""

from __future__ import annotations

import asyncio
from functools import partial

from app.alarms.monitor.line_alarms import LineAlarms
from app.audit.log import EventLog
from app.auth.sign_in.signin import SignIn
from app.database import Database
from app.feature import Feature, Services
from app.handover import api, pages
from app.handover.acts import ACTS
from app.handover.notes import api as notes_api
from app.handover.notes.pictures import PictureStore
from app.handover.service import Handover
from app.handover.sheet.document import SheetDocuments
from app.handover.signing.signing import Signing
from app.web.rendering.assets import Assets
from app.web.rendering.templating import Templates


def make(services: Services) -> None:
    settings, database, events = services.settings, services[Database], services[EventLog]
    pictures = services.add(PictureStore(settings.server.data, settings.shift.pictures_mb))
    services.lifespan.add("pictures", end=partial(asyncio.to_thread, pictures.close))
    handover = services.add(Handover(settings, database, events, pictures))
    templates, assets = services[Templates], services[Assets]
    documents = services.add(SheetDocuments(templates, assets, services[LineAlarms], pictures))
    services.add(Signing(handover, database, events, services[SignIn], documents.page))


FEATURE = Feature(make, (notes_api.router, api.router, pages.router), ACTS)
