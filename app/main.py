"""The app: wiring only."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from copy import copy
from importlib import import_module
from importlib.metadata import version

from fastapi import FastAPI
from starlette.middleware.gzip import GZipMiddleware

from app.auth.access import Identify, RecordRefusals
from app.server.forwarded import Forwarded
from app.server.security_headers import SecurityHeaders
from app.server.starting import StartInTurn
from app.settings import Settings
from app.web import problems
from app.web.anonymous import AnonymousInTurn
from app.web.arrival import Begun
from app.web.bounds import BoundedRequest
from app.web.routes import HeadAsGet, guard, refuse_undeclared
from app.web.security import AllowedHosts, HeaderRules, OwnPagesOnly
from app.web.services import Registry
from app.wiring import Services, running

FEATURES = (
    "app.web.pages",
    "app.web.schema",
    "app.metrics.api",
    "app.auth.api",
    "app.auth.pages",
    "app.auth.users",
    "app.audit.api",
    "app.audit.pages",
    "app.feed.socket",
    "app.live.api.routes",
    "app.live.api.stream_route",
    "app.alarms.performance_api",
    "app.alarms.occurrences_api",
    "app.alarms.api",
    "app.alarms.simulation.api",
    "app.alarms.simulation.pages",
    "app.alarms.pages",
    "app.alarms.notification.api",
    "app.alarms.notification.pages",
    "app.handover.api",
    "app.handover.pages",
    "app.live.browsers.socket",
    "app.live.pages",
    "app.commands.api.commands",
    "app.commands.api.safeguards",
    "app.commands.api.trace",
    "app.commands.pages.setpoints",
    "app.commands.pages.zero",
    "app.commands.pages.speed",
    "app.commands.pages.outputs",
    "app.commands.pages.parameters",
    "app.commands.pages.safeguards",
    "app.commands.pages.bus",
    "app.commands.pages.unit",
    "app.history.api.routes",
    "app.history.pages",
    "app.sets.api",
    "app.sets.restore_api",
    "app.sets.pages",
    "app.sets.restore_pages",
    "app.sets.batch_pages",
    "app.swap.pages",
    "app.recipes.api",
    "app.recipes.pages",
)
"""The modules with routes, in the order in which a path is looked up."""
_ROUTERS = [import_module(feature).router for feature in FEATURES]


def create_app(
    settings: Settings, *, demo: bool = False, worker_tokens: Mapping[str, str] | None = None
) -> FastAPI:
    """The complete app over ``settings``. ``demo``: requests from this machine are signed in.
    ``worker_tokens``: by bus, the token with which the server's own worker opens /feed.

    Raises StoreError when the data cannot be used, RuntimeError for a route that declares no role.
    """
    services = Services(settings, demo=demo, worker_tokens=worker_tokens or {})
    app = FastAPI(
        title="Lineside",
        summary="Monitor and command a line of DIGIMAX IV drives",
        version=version("lineside"),
        lifespan=_lifespan,
        openapi_url=None,
    )
    of_buses = {name: vars(bus).values() for name, bus in services.buses.items()}
    app.state.services, app.state.registry = services, Registry(vars(services).values(), of_buses)
    for router in _ROUTERS:
        # Not by include_router: that builds every route again, which is a third of a second of the start.
        # Copies: an app guards its own routes, and a process may have several apps.
        app.router.routes.extend(copy(route) for route in router.routes)
    problems.install(app)
    app.add_middleware(HeadAsGet)
    app.add_middleware(AnonymousInTurn)
    app.add_middleware(Identify, identity=services.identity, rechecks=services.rights.rechecks, demo=demo)
    app.add_middleware(BoundedRequest)
    app.add_middleware(OwnPagesOnly)
    app.add_middleware(RecordRefusals, events=services.events)
    app.add_middleware(GZipMiddleware, minimum_size=1000, compresslevel=5)
    app.add_middleware(AllowedHosts, allowed=settings.server.allowed_hosts)
    app.add_middleware(HeaderRules)
    app.add_middleware(SecurityHeaders)
    app.add_middleware(Forwarded, trusted=settings.server.trusted_proxies)
    app.add_middleware(StartInTurn)
    app.add_middleware(Begun)
    refuse_undeclared(app)
    guard(app, services.turns)
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    services: Services = app.state.services
    async with running(services):
        yield
