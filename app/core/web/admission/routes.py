"""The rules for every route: it declares a role or is public, the role is checked before a byte of the body
is read, and GET also responds to HEAD."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AsyncExitStack
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute, RouteContext, iter_route_contexts
from starlette.requests import HTTPConnection
from starlette.types import Message, Receive, Scope, Send

from app.core.server.turns import FairQueue
from app.core.web.admission.access import Requires, Role, caller_of, public
from app.core.web.admission.bounds import MAX_PLAIN_BODY_BYTES, bounded
from app.core.web.admission.turns import DOWNLOAD, SEARCH, Turns


def as_get(scope: Scope, send: Send) -> tuple[Scope, Send]:
    """Return a HEAD request as the GET that its route knows, and what sends the response. The server leaves
    the body out, as it knows the method; a stream ends with its first piece."""
    is_complete = False

    async def send_head(message: Message) -> None:
        nonlocal is_complete
        if is_complete:
            return
        await send(message)
        if message.get("more_body"):
            # What streams the rest learns from ``receive`` that the response is complete.
            is_complete = True
            await send({"type": "http.response.body", "body": b"", "more_body": False})

    return {**scope, "method": "GET"}, send_head


def _calls(dependant: Any) -> Iterator[Any]:
    for dependency in dependant.dependencies:
        yield dependency.call
        yield from _calls(dependency)


def required(app: FastAPI) -> Iterator[tuple[RouteContext, list[Any]]]:
    """Each route with what it declares: its `Requires`, or that it is `public`; an empty list: nothing."""
    for route in iter_route_contexts(app.routes):
        dependant = getattr(route, "dependant", None)
        calls = _calls(dependant) if dependant is not None else ()
        yield route, [call for call in calls if isinstance(call, Requires) or call is public]


def demands(app: FastAPI) -> list[tuple[RouteContext, set[Role | None]]]:
    """The roles that each route requires; ``None``: public, an empty set: none declared."""
    return [(route, {getattr(each, "role", None) for each in calls}) for route, calls in required(app)]


def refuse_undeclared(app: FastAPI) -> None:
    """Raises RuntimeError naming the first route that declares neither a role nor that it is public."""
    for route, roles in demands(app):
        if not roles:
            raise RuntimeError(f"{route.path} declares no role: add Requires(Role.…) or public to it")


def guard(app: FastAPI, turns: Turns) -> None:
    """Put every route behind a `RouteGuard`."""
    for route in app.routes:
        if isinstance(route, APIRoute):
            route.app = RouteGuard(route, turns)


class RouteGuard:
    """Grants the role that a route requires, bounds the body and waits for a turn, before the route reads
    anything: FastAPI reads and parses a body first and checks the role then.

    A route with files declares their size by FastAPI's ``max_body_size``. One that is a `SEARCH` or a
    `DOWNLOAD` has its turn until its response is sent. Every other GET has it until its response is made: to
    render a page of a long line takes the event loop tens of milliseconds, and the requests of others come in
    between; a stream that lasts delays no other request.
    """

    def __init__(self, route: APIRoute, turns: Turns) -> None:
        self._app = route.app
        self._requirements = [call for call in _calls(route.dependant) if isinstance(call, Requires)]
        self._most_bytes = route.max_body_size or MAX_PLAIN_BODY_BYTES
        self._turns: FairQueue[str] | None = None
        self._is_short = False
        if SEARCH in route.dependencies:
            self._turns = turns.searches
        elif DOWNLOAD in route.dependencies:
            self._turns = turns.downloads
        elif "GET" in (route.methods or ()):
            self._turns, self._is_short = turns.reads, True

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        connection = HTTPConnection(scope)
        for requirement in self._requirements:
            await requirement(connection)
        receive, caller = bounded(scope, receive, self._most_bytes), caller_of(connection)
        if self._turns is None or caller is None:
            await self._app(scope, receive, send)
            return
        async with AsyncExitStack() as turn:

            async def send_after_turn(message: Message) -> None:
                await turn.aclose()
                await send(message)

            await turn.enter_async_context(self._turns.turn(caller.account))
            await self._app(scope, receive, send_after_turn if self._is_short else send)
