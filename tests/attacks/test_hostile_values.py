"""Values of a query that a type admits and a calendar, a store or an integer does not: none fails a page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from urllib.parse import quote

import pytest
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute

from app.core.web.access import Role
from tests.app.complete_app import House
from tests.app.played_line import BUS
from tests.sizes import sizes

VALUES = ("\0", "-1", "9" * 20, "1e400", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00")
WITHOUT_END = "/api/v1/stream"


def queried(dependant: Dependant) -> Iterator[str]:
    """The names in the query of a route."""
    yield from (parameter.alias for parameter in dependant.query_params)
    for each in dependant.dependencies:
        yield from queried(each)


def addresses(house: House) -> Iterator[str]:
    """Each name of each query, with each of the values."""
    for route in house.app.routes:
        if not isinstance(route, APIRoute) or "GET" not in route.methods or route.path == WITHOUT_END:
            continue
        path = re.sub(r"{\w+(:\w+)?}", "1", route.path.replace("{bus}", BUS))
        for name in sorted(set(queried(route.dependant))):
            yield from (f"{path}?{name}={quote(value)}" for value in VALUES)


@pytest.mark.usefixtures("line")
@pytest.mark.parametrize("every", sizes(5, 1))
async def test_no_value_of_a_query_fails_a_request(house: House, every: int) -> None:
    """Of so many addresses one: there are six values, so that each comes to every fifth name."""
    client = await house.program(Role.ADMIN)
    chosen = [*addresses(house)][::every]
    tried = [(await client.get(address)).status_code for address in chosen]
    assert len(tried) > 100 * len(VALUES) // every
    assert {status for status in tried if status >= 500} == set()
