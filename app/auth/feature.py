"""Who: accounts, sign-ins, and what each may do."""

from __future__ import annotations

from app.audit.log import EventLog
from app.auth import api, pages, users
from app.auth.accounts import Accounts
from app.auth.acts import ACTS
from app.auth.oidc.single_sign_on import SingleSignOn
from app.auth.rights.identity import Identity
from app.auth.rights.rights import Rights
from app.auth.sign_in.first_admin import FirstAdmin
from app.auth.sign_in.signin import SignIn
from app.database import Database
from app.feature import Feature, Services
from app.server.admission.refusal_log import RefusalLog


def make(services: Services) -> None:
    settings, database, events = services.settings, services[Database], services[EventLog]
    site, buses = settings.site.name, list(services.buses)
    accounts = services.add(Accounts(database, events, buses=buses, site=site))
    rights = services.add(Rights(database))
    accounts.on_changed(rights.apply)
    services.lifespan.add("rights", rights.watch)
    sign_in = services.add(SignIn(database, events, settings.server.sessions, rights, site=site))
    single_sign_on = services.add(SingleSignOn(settings.oidc, accounts, sign_in, events))
    if settings.oidc is not None:
        services.lifespan.add(
            "company accounts", single_sign_on.watch, start=single_sign_on.start, end=single_sign_on.end
        )
    first_admin = services.add(FirstAdmin(accounts, sign_in, events))
    if not services.demo:
        services.lifespan.add("first admin", start=first_admin.start)
    services.add(RefusalLog())
    services.add(Identity(database, sign_in, services.worker_tokens))


FEATURE = Feature(make, (api.router, pages.router, users.router), ACTS)
