"""The app: its features, in the order in which each needs those before it, and what a request passes."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from copy import copy

from fastapi import FastAPI
from starlette.middleware.gzip import GZipMiddleware

from app.alarms import feature as alarms
from app.audit import feature as audit
from app.audit.log import EventLog
from app.auth import feature as auth
from app.auth.pages import CALLBACK
from app.auth.rights.access import Identify, RecordRefusals
from app.auth.rights.identity import Identity
from app.auth.rights.rights import Rights
from app.backup import feature as backup
from app.commands import feature as commands
from app.configuration import feature as configuration
from app.database import feature as database
from app.feature import Services
from app.feed import feature as feed
from app.find import feature as find
from app.handover import feature as handover
from app.help import feature as handbook
from app.history import feature as history
from app.live import feature as live
from app.live.browsers import feature as browsers
from app.metrics import feature as metrics
from app.notification import feature as notification
from app.peers import feature as peers
from app.postgresql import feature as postgresql
from app.recipes import feature as recipes
from app.reports import feature as reports
from app.server import feature as server
from app.server.admission.forwarded import Forwarded
from app.server.admission.refusal_log import RefusalLog
from app.server.admission.turns import HEALTH, RequestAdmission
from app.server.security_headers import SecurityHeaders
from app.sets import feature as sets
from app.settings import Settings
from app.swap import feature as swap
from app.tray import feature as tray
from app.version import VERSION
from app.web import feature as web
from app.web import problems
from app.web.admission.anonymous import AnonymousLimiter
from app.web.admission.bounds import RequestRules
from app.web.admission.routes import HeadAsGet, guard, refuse_undeclared
from app.web.admission.turns import Turns
from app.web.rendering.templating import Templates

FEATURES = (
    database.FEATURE,
    web.FEATURE,
    find.FEATURE,
    handbook.FEATURE,
    history.FEATURE,
    audit.FEATURE,
    server.FEATURE,
    auth.FEATURE,
    backup.FEATURE,
    configuration.FEATURE,
    live.FEATURE,
    feed.FEATURE,
    commands.FEATURE,
    sets.FEATURE,
    swap.FEATURE,
    recipes.FEATURE,
    tray.FEATURE,
    alarms.FEATURE,
    reports.FEATURE,
    notification.FEATURE,
    handover.FEATURE,
    peers.FEATURE,
    browsers.FEATURE,
    postgresql.FEATURE,
    metrics.FEATURE,
)


def create_app(
    settings: Settings,
    *,
    demo: bool = False,
    worker_tokens: Mapping[str, str] | None = None,
) -> FastAPI:
    """The complete app over ``settings``. ``demo``: requests from this machine are signed in.
    ``worker_tokens``: by bus, the token with which the server's own worker opens /feed. Its services run
    within its lifespan, or within that of ``app.state.services`` where the server does not call it.

    Raises StoreError when the data cannot be used, RuntimeError for a route that declares no role and for
    two services of one type.
    """
    services = Services(settings, demo=demo, worker_tokens=worker_tokens or {})
    app = FastAPI(
        title="Lineside",
        summary="Monitor and command a line of DIGIMAX IV drives",
        version=VERSION,
        lifespan=_lifespan,
        openapi_url=None,
    )
    app.state.services = services
    for feature in FEATURES:
        feature.make(services)
        # Not by include_router: that builds every route again, which is a third of a second of the start.
        # Copies: an app guards its own routes, and a process may have several apps.
        app.router.routes.extend(copy(route) for router in feature.routers for route in router.routes)
    for feature in FEATURES:
        services[Templates].permit({act.name: act.role for act in feature.acts})
    problems.install(app)
    app.add_middleware(HeadAsGet)
    # What waits for the provider of company accounts takes no turn from the login page.
    app.add_middleware(AnonymousLimiter, exempt=(HEALTH, CALLBACK))
    app.add_middleware(Identify, identity=services[Identity], rights=services[Rights], demo=demo)
    app.add_middleware(RequestRules, allowed_hosts=settings.server.allowed_hosts)
    app.add_middleware(GZipMiddleware, minimum_size=1000, compresslevel=5)
    app.add_middleware(SecurityHeaders)
    app.add_middleware(Forwarded, trusted=settings.server.trusted_proxies)
    app.add_middleware(RequestAdmission)
    app.add_middleware(RecordRefusals, events=services[EventLog], log=services[RefusalLog])
    refuse_undeclared(app)
    guard(app, services[Turns])
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    services: Services = app.state.services
    async with services.lifespan.running():
        yield
