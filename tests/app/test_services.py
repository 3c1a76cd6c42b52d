"""How routes reach the services."""

from __future__ import annotations

from collections.abc import Iterator
from inspect import isasyncgenfunction, iscoroutinefunction
from pathlib import Path

import pytest
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute, APIWebSocketRoute

from app.core.web.access import Requires
from app.core.web.services import Registry
from tests.app.complete_app import complete_app


async def test_no_route_waits_for_a_thread_to_look_something_up(tmp_path: Path) -> None:
    """FastAPI sends a plain function to a thread; a press of an operator would wait there."""
    async with complete_app(tmp_path) as house:
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


def test_a_service_is_found_by_its_type() -> None:
    registry = Registry(("text", 1))
    assert (registry[str], registry[int]) == ("text", 1)
    with pytest.raises(KeyError):
        registry[float]


def test_two_services_of_one_type_are_refused() -> None:
    with pytest.raises(RuntimeError, match="two services of the type int"):
        Registry(("text", 1, 2))
    Registry(("text",), {"dry-end": (1,), "wet-end": (2,)})


def test_a_service_is_added_once() -> None:
    services = Registry(("text",), {"dry-end": (1,), "wet-end": (2,)})
    assert services.add(2.5) == services[float]
    assert services.of_buses(int) == {"dry-end": 1, "wet-end": 2}
    with pytest.raises(RuntimeError, match="two services of the type float"):
        services.add(3.5)
