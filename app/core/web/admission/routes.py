"""The rules for every route: it declares a role or is public, the role is checked before a byte of the body
is read, and GET also responds to HEAD."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute, RouteContext, iter_route_contexts
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.web.admission.access import Requires, Role, public
from app.core.web.admission.bounds import MAX_PLAIN_BODY_BYTES, BoundedBody
from app.core.web.admission.turns import DOWNLOAD, SEARCH, ReadLimiter, Turns


class HeadAsGet:
    """Lets every GET route respond to HEAD. The server leaves the body out, as it knows the method; a stream
    ends with its first piece."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
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

        await self._app({**scope, "method": "GET"}, receive, send_head)


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
    """Check the role of every route, then the size of the body, before the route reads it; and limit the
    concurrent requests of an account.

    FastAPI reads and parses a body first and checks the role then. A route with files declares their size
    by FastAPI's ``max_body_size``; one that is a `SEARCH` or a `DOWNLOAD` has separate turns.
    """
    for route in app.routes:
        if isinstance(route, APIRoute):
            guarded: ASGIApp = BoundedBody(route.app, route.max_body_size or MAX_PLAIN_BODY_BYTES)
            if "GET" in (route.methods or ()) and not {SEARCH, DOWNLOAD} & set(route.dependencies):
                guarded = ReadLimiter(guarded, turns.reads)
            route.app = RolesFirst(
                guarded, [call for call in _calls(route.dependant) if isinstance(call, Requires)]
            )


class RolesFirst:
    """Raises Problem 401 or 403 before ``app`` is called."""

    def __init__(self, app: ASGIApp, requirements: list[Requires]) -> None:
        self._app = app
        self._requirements = requirements

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        for requirement in self._requirements:
            await requirement(HTTPConnection(scope))
        await self._app(scope, receive, send)
