"""The app: wiring only."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from copy import copy
from importlib.metadata import version

from fastapi import FastAPI
from starlette.middleware.gzip import GZipMiddleware

from app.alarms import api as alarms_api
from app.alarms import occurrences_api, own_api, performance_api
from app.alarms import pages as alarms_pages
from app.alarms.notification import api as notification_api
from app.alarms.notification import pages as notification_pages
from app.alarms.simulation import api as simulation_api
from app.alarms.simulation import pages as simulation_pages
from app.audit import api as audit_api
from app.audit import pages as audit_pages
from app.auth import api as auth_api
from app.auth import pages as auth_pages
from app.auth import users
from app.auth.access import Identify, RecordRefusals
from app.commands.api import commands as commands_api
from app.commands.api import safeguards as safeguards_api
from app.commands.api import trace
from app.commands.pages import bus, outputs, parameters, setpoints, speed, unit, zero
from app.commands.pages import safeguards as safeguards_pages
from app.feed import socket as feed
from app.handover import api as handover_api
from app.handover import pages as handover_pages
from app.history import pages as history_pages
from app.history.api import routes as history_api
from app.live import pages as live_pages
from app.live.api import routes as live_api
from app.live.api import stream_route
from app.live.browsers import socket as live_socket
from app.metrics import api as metrics_api
from app.recipes import api as recipes_api
from app.recipes import pages as recipes_pages
from app.server.forwarded import Forwarded
from app.server.security_headers import SecurityHeaders
from app.server.starting import StartInTurn
from app.sets import api as sets_api
from app.sets import batch_pages, restore_api, restore_pages
from app.sets import pages as sets_pages
from app.settings import Settings
from app.swap import pages as swap_pages
from app.web import pages as web_pages
from app.web import problems, schema
from app.web.anonymous import AnonymousInTurn
from app.web.arrival import Begun
from app.web.bounds import RequestRules
from app.web.routes import HeadAsGet, guard, refuse_undeclared
from app.web.services import Registry
from app.wiring import Services, running

FEATURES = (
    web_pages,
    schema,
    metrics_api,
    auth_api,
    auth_pages,
    users,
    audit_api,
    audit_pages,
    feed,
    live_api,
    stream_route,
    performance_api,
    occurrences_api,
    own_api,
    alarms_api,
    simulation_api,
    simulation_pages,
    alarms_pages,
    notification_api,
    notification_pages,
    handover_api,
    handover_pages,
    live_socket,
    live_pages,
    commands_api,
    safeguards_api,
    trace,
    setpoints,
    zero,
    speed,
    outputs,
    parameters,
    safeguards_pages,
    bus,
    unit,
    history_api,
    history_pages,
    sets_api,
    restore_api,
    sets_pages,
    restore_pages,
    batch_pages,
    swap_pages,
    recipes_api,
    recipes_pages,
)


def create_app(
    settings: Settings, *, demo: bool = False, worker_tokens: Mapping[str, str] | None = None
) -> FastAPI:
    """The complete app over ``settings``. ``demo``: requests from this machine are signed in.
    ``worker_tokens``: by bus, the token with which the server's own worker opens /feed. Its services run
    within its lifespan, or within :func:`app.wiring.running` where the server does not call that.

    Raises StoreError when the data cannot be used, RuntimeError for a route that declares no role and for
    two services of one type.
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
    for feature in FEATURES:
        # Not by include_router: that builds every route again, which is a third of a second of the start.
        # Copies: an app guards its own routes, and a process may have several apps.
        app.router.routes.extend(copy(route) for route in feature.router.routes)
    problems.install(app)
    app.add_middleware(HeadAsGet)
    app.add_middleware(AnonymousInTurn)
    app.add_middleware(Identify, identity=services.identity, rechecks=services.rechecks, demo=demo)
    app.add_middleware(RequestRules, allowed_hosts=settings.server.allowed_hosts)
    app.add_middleware(RecordRefusals, events=services.events)
    app.add_middleware(GZipMiddleware, minimum_size=1000, compresslevel=5)
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
