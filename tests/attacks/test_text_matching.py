"""Text of a request, and what people have typed, in what is rendered in a language."""

from __future__ import annotations

import string
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from fastapi.routing import APIRoute

from app.core.messages import Language
from app.core.web.access import Role
from app.core.web.formats import Formats
from app.core.web.request_rules import MAX_QUERY
from tests.app.complete_app import House
from tests.sizes import sizes

MARK = "zq7"
HOSTILE = f"{MARK}: {MARK}; {MARK}"
CPU_S = 0.25
"""Of this thread, a hundred times what the dearest text takes; n^k places take minutes to years."""
ADDRESS_TEXTS = [
    *("\0", "\ufffd", "..", "../../etc/passwd", "%s%n", "{0.__class__}", "{", "'\""),
    *("-1", "1e9", "9" * 300),
]


@pytest.fixture
def looked_up(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Every text that is looked up in a catalog."""
    found: list[str] = []
    term = Language.term

    def recording(self: Language, text: str) -> str:
        found.append(text)
        return term(self, text)

    monkeypatch.setattr(Language, "term", recording)
    return found


@pytest.mark.parametrize("part", ["1", ",111", "1,111", " 1.1", "-1.1", "1.1,1", "1.", "-"])
def test_numbers_without_end_cost_no_more_than_their_length(part: str) -> None:
    """A refusal has its numbers as the reader writes them, also those that came with the request."""
    text = f" 1{part * (MAX_QUERY // len(part))}x"
    begun = time.thread_time()
    Formats("de").typed_number(text)
    assert time.thread_time() - begun < CPU_S


def requests_of(route: APIRoute) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Requests with the hostile text in each place that a route reads, and in places that it does not."""
    names = [param.alias for param in route.dependant.query_params]
    query = dict.fromkeys([*names, HOSTILE], HOSTILE)
    fields = {param.alias: HOSTILE for param in route.dependant.body_params} | {HOSTILE: HOSTILE}
    present = filled(route.path, "")
    for method in sorted(route.methods):
        if "{" in route.path:
            yield method, filled(route.path, HOSTILE), {"params": query}
        if method in ("GET", "HEAD"):
            yield method, present, {"params": query}
        elif route.path.startswith("/api/"):
            body = {HOSTILE: HOSTILE, "value": HOSTILE, "raw": HOSTILE}
            headers = {"idempotency-key": HOSTILE}
            yield method, present, {"params": query, "json": body, "headers": headers}
        else:
            yield method, present, {"params": query, "data": fields}


def filled(path: str, text: str) -> str:
    """The path of a route with ``text`` in each parameter; where it is empty, what there is."""
    known = {"bus": "dry-end", "unit": "1", "unit_id": "1"}
    parts = []
    for literal, name, _, _ in string.Formatter().parse(path):
        parts += [literal, (text or known.get(name, "1")) if name else ""]
    return "".join(parts)


@pytest.mark.parametrize("accept", sizes("text/html", "application/json"))
async def test_no_text_of_a_request_is_looked_up_in_a_catalog(
    house: House, looked_up: list[str], accept: str
) -> None:
    client = await house.signed_in(Role.ADMIN)
    client.headers.update({"accept-language": "de", "accept": accept, "referer": f"http://x/{HOSTILE}"})
    routes = [route for route in house.app.routes if isinstance(route, APIRoute)]
    skipped = ("/logout", "/stream", "/openapi.json")
    for route in routes:
        for method, path, more in requests_of(route):
            if not path.endswith(skipped):
                response: httpx.Response = await client.request(method, path, **more)
                assert response.status_code < 500 or response.status_code == 503, (
                    method,
                    path,
                    response.text,
                )
    assert [text for text in looked_up if MARK in text] == []


@pytest.mark.soak
async def test_no_text_of_an_address_makes_a_route_fail(house: House) -> None:
    client = await house.signed_in(Role.ADMIN)
    for route in (route for route in house.app.routes if isinstance(route, APIRoute)):
        names = [param.alias for param in route.dependant.query_params]
        is_requested = "GET" in route.methods and not route.path.endswith("/stream")
        if is_requested and (names or "{" in route.path):
            for text in ADDRESS_TEXTS:
                # Encoded, the dots reach the route; the client would resolve them.
                path = quote(filled(route.path, text)).replace("..", "%2E%2E")
                response = await client.get(path, params=dict.fromkeys(names, text))
                assert response.status_code < 500, (path, response.text)
