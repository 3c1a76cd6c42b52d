"""Who: accounts, sign-ins, and what each may do."""

from __future__ import annotations

import asyncio
from functools import partial

from app.audit.log import EventLog
from app.auth import api, pages, users
from app.auth.accounts import Accounts
from app.auth.acts import ACTS
from app.auth.identity import Identity
from app.auth.lasting import Rechecks
from app.auth.passwords import Passwords
from app.auth.rights import Rights
from app.auth.rules import Lifetimes
from app.auth.signin import SignIn
from app.database import Database
from app.feature import Feature, Services
from app.server.refusal_log import RefusalLog


def make(services: Services) -> None:
    settings, database, events = services.settings, services[Database], services[EventLog]
    site, buses = settings.site.name, list(services.buses)
    passwords, rechecks = services.add(Passwords()), services.add(Rechecks())
    services.lifespan.add("passwords", end=partial(asyncio.to_thread, passwords.close))
    accounts = services.add(Accounts(database, passwords, events, buses=buses, site=site))
    rights = services.add(Rights(database, accounts, rechecks))
    services.lifespan.add("rights", rights.watch)
    lifetimes = Lifetimes.of(settings.server.sessions)
    sign_in = services.add(SignIn(database, passwords, events, lifetimes, site=site, rechecks=rechecks))
    services.add(RefusalLog())
    services.add(Identity(database, sign_in, services.worker_tokens))


FEATURE = Feature(make, (api.router, pages.router, users.router), ACTS)
