"""How routes reach the services."""

from __future__ import annotations

from collections.abc import Iterator
from inspect import isasyncgenfunction, iscoroutinefunction
from pathlib import Path

from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute, APIWebSocketRoute

from app.web.access import Requires
from tests.app.whole_app import whole_app


async def test_no_route_waits_for_a_thread_to_look_something_up(tmp_path: Path) -> None:
    """FastAPI sends a plain function to a thread; a press of an operator would wait there."""
    async with whole_app(tmp_path) as house:
        routes = [route for route in house.app.routes if isinstance(route, APIRoute | APIWebSocketRoute)]
    assert len(routes) > 100
    plain = {
        f"{route.path}: {call}"
        for route in routes
        for call in calls_of(route.dependant)
        if not (iscoroutinefunction(call) or isasyncgenfunction(call) or isinstance(call, Requires))
    }
    assert plain == set()


def calls_of(dependant: Dependant) -> Iterator[object]:
    """What FastAPI calls for a request: its dependencies, theirs, and the route's own function."""
    yield dependant.call
    for needed in dependant.dependencies:
        yield from calls_of(needed)
