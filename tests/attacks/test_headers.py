"""Requests whose headers could be read in two ways: a proxy reads one of them, this server the other."""

from __future__ import annotations

import httpx

from app.core.web.access import Role
from tests.app.complete_app import House
from tests.for_each import for_each

LIMITS = "/api/v1/buses/dry-end/units/1/limits"


@for_each(
    ("name", "values"),
    [
        ("Host", ("a", "b")),
        ("Origin", ("http://app", "http://evil.example")),
        ("Authorization", ("Bearer x", "Bearer y")),
        ("Content-Type", ("application/json", "text/plain")),
        ("Idempotency-Key", ("one", "two")),
    ],
)
async def test_a_header_that_stands_twice(house: House, name: str, values: tuple[str, str]) -> None:
    engineer = await house.program(Role.ENGINEER)
    request = engineer.build_request("PUT", LIMITS, json={})
    kept = [(key, value) for key, value in request.headers.multi_items() if key != name.lower()]
    request.headers = httpx.Headers([*kept, *((name, value) for value in values)])
    response = await engineer.send(request)
    assert response.status_code == 400
    assert response.json()["code"] == "malformed"
    assert name in response.json()["detail"]


async def test_http_1_1_without_a_host(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    request = engineer.build_request("GET", "/healthz")
    del request.headers["host"]
    assert (await engineer.send(request)).status_code == 400


@for_each(
    ("name", "value", "status"),
    [
        ("Content-Encoding", "gzip", 415),
        ("Content-Encoding", "identity", 200),
        ("Transfer-Encoding", "gzip, chunked", 501),
        ("Transfer-Encoding", "Chunked", 200),
    ],
)
async def test_a_body_in_a_coding_that_is_not_decoded(
    house: House, name: str, value: str, status: int
) -> None:
    engineer = await house.program(Role.ENGINEER)
    response = await engineer.put(LIMITS, json={}, headers={name: value})
    assert response.status_code == status
    if status != 200:
        assert response.json()["code"] == "unsupported_type"
