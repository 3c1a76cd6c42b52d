"""Requests that cost more than they weigh, can be read in two ways, or hold what a store does not."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from starlette.types import Message, Scope

from app.core.web import api as schema
from app.core.web.access import Role
from app.core.web.request_rules import (
    MAX_BODY_BYTES,
    MAX_CONTENT_TYPE,
    MAX_PARAMETERS,
    MAX_PLAIN_BODY_BYTES,
    MAX_QUERY,
)
from app.engineering.sets.store import MAX_LINES, MAX_VALUES, DocumentError, read_document
from tests.app.complete_app import House
from tests.app.played_line import BUS
from tests.for_each import for_each
from tests.sizes import sizes

SPEED = "/api/v1/buses/dry-end/units/1/speed"
RESTORES = "/api/v1/buses/dry-end/units/1/restores"
CPU_S = 1.0
"""Of this thread, many times what any of these takes; the attack took seconds to minutes."""
JSON = {"content-type": "application/json"}


async def cpu_s(client: httpx.AsyncClient, status: int, path: str, content: bytes, **headers: str) -> float:
    """Return the CPU time of the event loop's thread for a request, which must return ``status``."""
    begun = time.thread_time()
    response = await client.post(path, content=content, headers=headers)
    taken = time.thread_time() - begun
    assert response.status_code == status, response.text[:200]
    return taken


@for_each("path", [SPEED, RESTORES])
async def test_keys_by_the_thousand_cost_no_more_than_their_length(house: House, path: str) -> None:
    engineer = await house.program(Role.ENGINEER)
    size = MAX_BODY_BYTES if path == RESTORES else MAX_PLAIN_BODY_BYTES
    keys = ",".join(f'"{n:06}":0' for n in range(size // 11 - 2))
    assert await cpu_s(engineer, 422, path, f"{{{keys}}}".encode(), **JSON) < CPU_S


@for_each("part", ["[", '{"a":', '"\\ud800",'])
async def test_endless_nesting_is_malformed(house: House, part: str) -> None:
    engineer = await house.program(Role.ENGINEER)
    content = (part * MAX_PLAIN_BODY_BYTES)[:MAX_PLAIN_BODY_BYTES].encode()
    assert await cpu_s(engineer, 422, SPEED, content, **JSON) < CPU_S


async def test_a_key_of_half_a_surrogate_pair_gets_a_response(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    for body in (b'{"raw": 1, "\\ud800": 2}', b'{"\\ud800": 1, "\\ud800": 2}'):
        response = await engineer.post(SPEED, content=body, headers=JSON)
        assert (response.status_code, response.json()["code"]) == (422, "invalid")


async def test_a_body_with_many_faults_is_refused_with_the_first(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    response = await engineer.post(SPEED, json={f"k{n}": 0 for n in range(900)})
    assert (response.status_code, len(response.json()["errors"])) == (422, 20)


@for_each("path", [SPEED, RESTORES, "/units/dry-end/1/restore", "/setpoints/review"])
@for_each("role", [None, Role.VIEWER])
async def test_who_may_not_is_refused_before_the_body_is_read(
    house: House, path: str, role: Role | None
) -> None:
    token = {"Authorization": f"Bearer {await house.token(role)}"} if role else {}
    headers = {"host": "plant.example", "content-type": "application/json", "content-length": "5", **token}
    scope: Scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": "POST",
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "query_string": b"",
        "headers": [(name.lower().encode(), value.encode()) for name, value in headers.items()],
        "client": ("192.0.2.7", 1),
        "server": ("plant.example", 80),
    }
    sent: list[Message] = []

    async def receive() -> Message:
        raise AssertionError("the body was read")

    async def send(message: Message) -> None:
        sent.append(message)

    await house.app(scope, receive, send)
    assert sent[0]["status"] == (403 if role else 303 if not path.startswith("/api/") else 401)


async def test_only_what_carries_a_file_may_be_large(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    large = json.dumps({"document": "x" * MAX_PLAIN_BODY_BYTES}).encode()
    assert (await engineer.post(SPEED, content=large, headers=JSON)).status_code == 413
    response = await engineer.post(RESTORES, content=large, headers=JSON)
    assert (response.status_code, "not readable as TOML" in response.text) == (422, True)


@for_each("charset", ["punycode", "utf-8", "idna", '"utf-7"'])
async def test_the_parts_of_a_form_are_decoded_by_no_codec_of_the_senders_choice(
    house: House, charset: str
) -> None:
    part = b'--b\r\nContent-Disposition: form-data; name="name"\r\n\r\n' + b"9" * 50_000 + b"\r\n--b--\r\n"
    kind = f"multipart/form-data; charset={charset}; boundary=b"
    assert await cpu_s(house.client(), 415, "/login", part, **{"content-type": kind}) < CPU_S


@for_each(
    ("name", "value", "status"),
    [
        ("cookie", 'lineside_session="' + "\\\\" * 15_000 + '"', 401),
        ("cookie", 'x="' + "\\\\" * 15_000 + '"; y', 401),
        ("cookie", "a=b;" * 7000, 401),
        ("content-type", "multipart/form-data" + ";" * 30_000, 415),
        ("content-type", "multipart/form-data; boundary=" + "b" * MAX_CONTENT_TYPE, 415),
        ("authorization", "Bearer " + "a " * 15_000, 401),
        ("accept-language", "de;q=0.1," * 3000, 401),
        ("referer", "http://" + "[" * 30_000, 401),
        ("hx-current-url", "http://" + "@:" * 15_000, 401),
        ("origin", "http://" + "[" * 30_000, 403),
        ("host", "[" * 30_000, 401),
        ("lineside-clicked-at", "9" * 30_000, 401),
    ],
)
async def test_no_header_costs_more_than_its_length(house: House, name: str, value: str, status: int) -> None:
    headers = {"accept": "application/json", "hx-request": "true", name: value}
    assert await cpu_s(house.client(), status, "/login" if status == 415 else SPEED, b"", **headers) < CPU_S


@for_each("query", ["a" * (MAX_QUERY + 1), "&" * (MAX_PARAMETERS + 1), "a&" * 9000])
async def test_an_address_beyond_any_page_is_refused(house: House, query: str) -> None:
    response = await house.client().get(f"/login?{query}")
    assert (response.status_code, response.json()["code"]) == (414, "too_long")


@for_each("number", ["9" * 5000, "\u0661", "1_0", "+1", " 1"])
async def test_no_number_of_an_address_makes_the_server_fail(house: House, number: str) -> None:
    client = await house.signed_in(Role.ENGINEER)
    body = {"name": "n", "setpoints": {number: 1}}
    response = await client.post("/api/v1/buses/dry-end/recipes", json=body)
    assert (response.status_code, response.json()["code"]) == (422, "invalid")
    for path in (
        f"/api/v1/history/series?series=dry-end/{number}/actual",
        f"/sets/compare?one=set:{number}:1&other=set:1:{number}",
        f"/events?unit={number[:3]}&before={number[:18]}",
    ):
        assert (await client.get(path)).status_code in (200, 404, 422), path
    for data in ({"source": f"{number}:1"}, {"source": f"1:{number}"}):
        assert (await client.post("/units/dry-end/1/restore", data=data)).status_code in (404, 422)
    batch = {"number": number, f"unit-{number}": "1"}
    assert (await client.post("/batch/dry-end/review", data=batch)).status_code in (404, 422)


@pytest.mark.parametrize(
    "text",
    [
        "a." * 3000 + "a = 1\n",
        '"a".' * 3000 + "a = 1\n",
        "[" + "a." * 3000 + "b]\n",
        " \t[" + "a." * 1000 + 'b]\nc = """\n[\n"""\n' + "".join(f"k{n} = 1\n" for n in range(3000)),
        "[" + "a." * 500 + "b]\n" + "".join(f"k{n}.a.b.c = 1\n" for n in range(1500)),
    ],
    ids=["key", "quoted key", "table", "keys of a deep table", "dotted keys of a deep table"],
)
def test_keys_of_many_parts_cost_no_more_than_their_length(text: str) -> None:
    begun = time.thread_time()
    with pytest.raises(DocumentError, match="too many dotted parts"):
        read_document(text)
    assert time.thread_time() - begun < CPU_S


@pytest.mark.parametrize(
    "document",
    [
        "".join(f"k{n} = 1\n" for n in range(MAX_LINES + 1)),
        "k = [" + "1," * (MAX_VALUES + 1) + "]",
        "k = {" + "a=1," * (MAX_VALUES + 1) + "}",
    ],
)
def test_a_file_of_more_values_than_a_bus_has_is_not_parsed(
    monkeypatch: pytest.MonkeyPatch, document: str
) -> None:
    monkeypatch.setattr("tomllib.loads", lambda _: pytest.fail("parsed"))
    with pytest.raises(DocumentError, match="too long"):
        read_document(document)


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
@pytest.mark.parametrize("every", sizes(11, 1))
async def test_no_value_of_a_query_fails_a_request(house: House, every: int) -> None:
    """Of so many addresses one: there are six values, so that each comes to every eleventh name."""
    client = await house.program(Role.ADMIN)
    chosen = [*addresses(house)][::every]
    tried = [(await client.get(address)).status_code for address in chosen]
    assert len(tried) > 100 * len(VALUES) // every
    assert {status for status in tried if status >= 500} == set()


PATH = "/api/v1/openapi.json"


async def test_it_is_made_once_for_all_who_request_it_and_who_has_it_gets_no_second_one(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, make = list[dict[str, Any]](), schema.openapi_document

    def counted(app: Any) -> dict[str, Any]:
        made.append(make(app))
        return made[-1]

    monkeypatch.setattr(schema, "openapi_document", counted)
    client = await house.program(Role.VIEWER)
    responses = await asyncio.gather(*(client.get(PATH) for _ in range(5)))
    assert [response.json() == made[0] for response in responses] == [True] * 5
    assert len(made) == 1
    first = responses[0]
    assert (first.status_code, first.headers["content-encoding"]) == (200, "gzip")
    again = await client.get(PATH, headers={"if-none-match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    plain = await client.get(PATH, headers={"accept-encoding": "identity", "if-none-match": 'W/"other"'})
    assert (plain.status_code, plain.json()) == (200, first.json())
    assert "content-encoding" not in plain.headers
