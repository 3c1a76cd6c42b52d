"""The feature of accounts, of sign-ins, and of the rights of each account."""

from __future__ import annotations

from app.core.database import Database
from app.core.server.refusal_log import RefusalLog
from app.feature import Feature, Services
from app.people.audit.log import EventLog
from app.people.auth import pages
from app.people.auth.accounts import ACTS, Accounts
from app.people.auth.identify import Identity
from app.people.auth.rights import Rights
from app.people.auth.sign_in import FirstAdmin, SignIn
from app.people.auth.single_sign_on import SingleSignOn


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
    services.add(Identity(database, sign_in, rights, services.worker_tokens))


FEATURE = Feature(make, (pages.api_router, pages.router), ACTS)
