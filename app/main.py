"""The app: its features, in the order in which each needs those before it, and the middleware of a
request."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager

from fastapi import FastAPI
from starlette.middleware.gzip import GZipMiddleware

from app.core.database import feature as database
from app.core.find import feature as find
from app.core.help import feature as handbook
from app.core.server import feature as server
from app.core.server.addresses import Forwarded
from app.core.server.refusal_log import RefusalLog
from app.core.server.refusals import SecurityHeaders
from app.core.web import feature as web
from app.core.web import problems
from app.core.web.request_rules import HEALTH
from app.core.web.routes import AnonymousLimiter, refuse_unguarded
from app.core.web.templating import Templates
from app.engineering.recipes import feature as recipes
from app.engineering.sets import feature as sets
from app.engineering.swap import feature as swap
from app.engineering.tray import feature as tray
from app.feature import Services
from app.line.alarms import feature as alarms
from app.line.commands import feature as commands
from app.line.feed import feature as feed
from app.line.history import feature as history
from app.line.live import feature as live
from app.people.audit import feature as audit
from app.people.audit.log import EventLog
from app.people.auth import feature as auth
from app.people.auth.identify import Identify, Identity
from app.people.auth.pages import CALLBACK
from app.people.auth.rights import Rights
from app.records.handover import feature as handover
from app.records.notification import feature as notification
from app.records.reports import feature as reports
from app.settings import Settings
from app.system.backup import feature as backup
from app.system.configuration import feature as configuration
from app.system.metrics import feature as metrics
from app.system.mqtt import feature as mqtt
from app.system.opcua import feature as opcua
from app.system.peers import feature as peers
from app.system.postgresql import feature as postgresql
from app.system.state import feature as state
from app.version import VERSION

FEATURES = (
    database.FEATURE,
    web.FEATURE,
    find.FEATURE,
    handbook.FEATURE,
    history.FEATURE,
    audit.FEATURE,
    server.FEATURE,
    auth.FEATURE,
    configuration.FEATURE,
    live.FEATURE,
    feed.FEATURE,
    commands.FEATURE,
    sets.FEATURE,
    swap.FEATURE,
    recipes.FEATURE,
    tray.FEATURE,
    alarms.FEATURE,
    handover.FEATURE,
    reports.FEATURE,
    notification.FEATURE,
    backup.FEATURE,
    peers.FEATURE,
    postgresql.FEATURE,
    mqtt.FEATURE,
    opcua.FEATURE,
    metrics.FEATURE,
    state.FEATURE,
)


def create_app(
    settings: Settings,
    *,
    demo: bool = False,
    worker_tokens: Mapping[str, str] | None = None,
) -> FastAPI:
    """Return the complete app over ``settings``. ``demo``: requests from this machine are signed in.
    ``worker_tokens``: by bus, the token with which the server's own worker opens /feed. Its services run
    within its lifespan, or within that of ``app.state.services`` where the server does not call it.

    Raise StoreError when the data cannot be used, RuntimeError for a route without a guard and for
    two services of one type.
    """
    services = Services(settings, demo=demo, worker_tokens=worker_tokens or {})
    app = FastAPI(
        title="Lineside",
        summary="Monitor and command a line of DIGIMAX IV drives",
        version=VERSION,
        lifespan=_lifespan,
        openapi_url=None,
        # Nothing here is a provider of OpenTelemetry, which FastAPI would look for at each request.
        telemetry={"tracing": False, "metrics": False, "logs": False},
    )
    app.state.services = services
    for feature in FEATURES:
        feature.make(services)
    # A request passes all routes before its own: those of commands are the first.
    for feature in sorted(FEATURES, key=lambda each: each is not commands.FEATURE):
        # The router of an app would analyze every included route again.
        app.router.routes.extend(route for router in feature.routers for route in router.routes)
    for feature in FEATURES:
        services[Templates].permit({act.name: act.role for act in feature.acts})
    problems.install(app)
    # Requests that wait for the provider of company accounts take no turn from the login page.
    app.add_middleware(AnonymousLimiter, exempt=(HEALTH, CALLBACK))
    app.add_middleware(
        Identify,
        identity=services[Identity],
        rights=services[Rights],
        events=services[EventLog],
        log=services[RefusalLog],
        allowed_hosts=settings.server.allowed_hosts,
        demo=demo,
    )
    app.add_middleware(GZipMiddleware, minimum_size=1000, compresslevel=5)
    app.add_middleware(SecurityHeaders)
    app.add_middleware(
        Forwarded, trusted=settings.server.trusted_proxies, note_refusal=services[RefusalLog].note
    )
    refuse_unguarded(app)
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    services: Services = app.state.services
    async with services.lifespan.running():
        yield
