"""Refusals: problem+json for programs, a page or a fragment for people."""

from __future__ import annotations

import json

import httpx
import pytest

from app.core.server.refusals import HEADERS
from app.core.web.access import Role
from app.core.web.problems import problem_json
from app.errors import Problem, StoreError
from app.people.audit.log import EventLog
from app.people.auth.identify import Identity
from bus.messages import Message
from tests.app.complete_app import House
from tests.for_each import for_each

SPEED = "/api/v1/buses/dry-end/units/1/speed"


@pytest.fixture
async def engineer(house: House) -> httpx.AsyncClient:
    return await house.program(Role.ENGINEER)


def check_problem(response: httpx.Response, status: int, code: str) -> None:
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert (problem["type"], problem["status"], problem["code"]) == ("about:blank", status, code)
    assert problem["title"]
    assert problem["detail"]


async def test_an_unknown_call_method_bus_and_unit(engineer: httpx.AsyncClient) -> None:
    check_problem(await engineer.get("/api/v1/nowhere"), 404, "not_found")
    response = await engineer.delete("/api/v1/line")
    check_problem(response, 405, "method_not_allowed")
    assert response.headers["allow"] == "GET, HEAD"
    # Several methods of a path stand in as many routes.
    response = await engineer.post("/api/v1/buses/dry-end/units/1/limits", json={})
    check_problem(response, 405, "method_not_allowed")
    assert response.headers["allow"] == "GET, HEAD, PUT"
    check_problem(await engineer.get("/api/v1/buses/nix/units/1"), 404, "unknown_bus")
    check_problem(await engineer.get("/api/v1/buses/dry-end/units/99"), 404, "unknown_unit")


@for_each(
    "body",
    [
        b"{",
        b"",
        b"[]",
        b"null",
        b"\xff\xfe",
        b'{"raw": "x"}',
        b'{"raw": 1e400}',
        b'{"raw": NaN}',
        b'{"raw": 1, "surplus": 2}',
        b"[" * 5000,
        b'{"raw": 1' + b"0" * 5000 + b"}",
    ],
)
async def test_malformed_input_is_invalid_and_states_that_nothing_was_sent(
    engineer: httpx.AsyncClient, body: bytes
) -> None:
    response = await engineer.post(SPEED, content=body, headers={"content-type": "application/json"})
    check_problem(response, 422, "invalid")
    assert "nothing was sent" in response.json()["detail"]


async def test_faults_are_in_the_text_and_each_as_data_once(engineer: httpx.AsyncClient) -> None:
    response = await engineer.post(SPEED, json={"raw": "x", "surplus": 2})
    problem = response.json()
    assert problem["detail"].startswith("raw: it must be an integer; surplus: there is no such field;")
    assert problem["params"] == {}
    assert problem["errors"] == [
        {"where": "raw", "code": "fault_not_an_integer", "params": {}, "detail": "it must be an integer"},
        {"where": "surplus", "code": "fault_no_such_field", "params": {}, "detail": "there is no such field"},
    ]


def test_a_reason_within_remarks_is_named_with_its_values_and_has_one_text() -> None:
    late = Message.of("came_too_late", age="3.0", allowed="2")
    because = Message.of("outcome_because", outcome=Message("outcome_not_sent"), reason=late)
    body = json.loads(
        problem_json(Problem(409, "controlled", Message.of("nothing_sent", reason=because))).body
    )
    assert (body["code"], body["reason"]) == ("controlled", "came_too_late")
    assert body["params"] == {"age": "3.0", "allowed": "2"}
    assert body["detail"].endswith("; nothing was sent")
    assert [name for name, value in body.items() if body["detail"] in str(value)] == ["detail"]


async def test_an_address_longer_than_any_is_refused(engineer: httpx.AsyncClient) -> None:
    check_problem(await engineer.get("/api/v1/buses/dry-end/units/" + "9" * 5000), 414, "too_long")


@for_each(
    ("body", "kind", "words"),
    [
        (b'{"raw": 5}', "text/plain", "body: it must be a JSON object"),
        (b'{"raw": 5, "rav": 5}', "application/json", "rav: there is no such field"),
        (b'{"raw": 5, "value": "5"}', "application/json", "body: give either raw"),
        (b"", "application/json", "body: it is missing"),
    ],
)
async def test_a_fault_is_explained_with_what_to_do(
    engineer: httpx.AsyncClient, body: bytes, kind: str, words: str
) -> None:
    response = await engineer.post(SPEED, content=body, headers={"content-type": kind})
    check_problem(response, 422, "invalid")
    assert response.json()["detail"].startswith(words)


async def test_a_page_for_people_and_a_fragment_for_htmx(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    page = await client.get("/nowhere", headers={"accept": "text/html"})
    assert page.status_code == 404
    assert "<!doctype html>" in page.text
    assert "there is no page at /nowhere" in page.text
    part = await client.get("/nowhere", headers={"hx-request": "true"})
    assert part.status_code == 404
    assert "<!doctype" not in part.text
    assert 'role="alert"' in part.text


@for_each(
    ("left", "link"),
    [
        ("http://server/trends?span=600&s=a", "/trends?span=600&amp;s=a"),
        ("http://server//elsewhere.example/x", "/elsewhere.example/x"),
        ("javascript:alert(1)", "/"),
        ("", "/"),
    ],
)
async def test_a_refused_form_leads_back_to_its_page(house: House, left: str, link: str) -> None:
    """Which has what was typed as a draft."""
    client = await house.signed_in(Role.VIEWER)
    headers = {"accept": "text/html", "referer": left}
    page = await client.post("/trends/views", data={"name": "N" * 10_000}, headers=headers)
    assert (page.status_code, "at most 200 characters" in page.text) == (422, True)
    assert f'<a class="button" href="{link}">' in page.text


async def test_a_form_about_something_gone_leads_to_the_line(house: House) -> None:
    """Its page, of a restore that was planned before a restart, has the same answer."""
    client = await house.signed_in(Role.ENGINEER)
    headers = {"accept": "text/html", "referer": "http://server/restores/gone"}
    page = await client.post("/restores/gone/start", headers=headers)
    assert (page.status_code, '<a class="button" href="/">' in page.text) == (404, True)


async def test_words_of_a_request_are_never_markup(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    page = await client.get("/<img src=x>", headers={"accept": "text/html"})
    assert "<img src=x>" not in page.text


async def test_a_failing_store_is_reported(
    house: House, engineer: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(*_: object) -> None:
        raise StoreError(
            Message.of(
                "system_error", error="the store x: the disk is full; nothing was stored; free some space"
            )
        )

    monkeypatch.setattr(house.services[EventLog], "page", fail)
    response = await engineer.get("/api/v1/events")
    check_problem(response, 503, "store")
    assert "the disk is full" in response.json()["detail"]


async def test_a_store_that_fails_at_the_door_refuses(
    house: House, engineer: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(*_: object) -> None:
        raise StoreError(Message.of("store_failed", path="x", reason=Message("store_disk_failed")))

    monkeypatch.setattr(house.services[Identity], "by_token", fail)
    check_problem(await engineer.get("/api/v1/line"), 503, "store")
    assert (await house.client().get("/healthz")).status_code == 200


async def test_an_internal_error_reveals_nothing(
    house: House, engineer: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(*_: object) -> None:
        raise ZeroDivisionError("a secret of the inside")

    monkeypatch.setattr(house.services[EventLog], "page", fail)
    transport = httpx.ASGITransport(house.app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://x", headers=engineer.headers) as other:
        response = await other.get("/api/v1/events")
    check_problem(response, 500, "failed")
    assert "secret" not in response.text
    assert {name: response.headers.get(name) for name in HEADERS} == HEADERS


@for_each(
    ("path", "body", "key"),
    [
        ("/units/1/speed", b'{"raw": 5, "raw": 50}', "'raw'"),
        ("/speeds", b'{"setpoints": {"1": {"raw": 5}, "1": {"raw": 50}}}', "'1'"),
        ("/speeds", b'{"setpoints": {"1": {"raw": 5, "raw": 5}}}', "'raw'"),
        ("/units/1/speed", b'{"\\ud800": 5, "\\ud800": 5}', r"'\ud800'"),
    ],
)
async def test_a_key_that_is_given_twice_means_nothing(
    engineer: httpx.AsyncClient, path: str, body: bytes, key: str
) -> None:
    headers = {"content-type": "application/json"}
    response = await engineer.post(f"/api/v1/buses/dry-end{path}", content=body, headers=headers)
    check_problem(response, 422, "invalid")
    assert response.json()["detail"] == f"{key}: it is given twice; nothing was sent"


@for_each(
    ("query", "words"),
    [
        ("limt=5", "limt: there is no such parameter; there are: "),
        ("limit=5&limit=6", "limit: it is given twice"),
    ],
)
async def test_a_query_that_would_be_guessed_at(engineer: httpx.AsyncClient, query: str, words: str) -> None:
    response = await engineer.get(f"/api/v1/events?{query}")
    check_problem(response, 422, "invalid")
    assert response.json()["detail"].startswith(words)


async def test_what_may_be_given_several_times_is(engineer: httpx.AsyncClient) -> None:
    series = "series=dry-end/1/actual&series=dry-end/2/actual"
    span = "from=2026-11-21T00:00:00Z&to=2026-11-21T01:00:00Z"
    response = await engineer.get(f"/api/v1/history/series?{series}&{span}")
    assert len(response.json()) == 2


@for_each(
    ("path", "body"),
    [
        ("/units/1/block", {"reason": "a\0b"}),
        ("/sets", {"name": "a\x1b[2J"}),
        ("/sets", {"comment": "a\x1b[2J", "name": "n"}),
        ("/recipes", {"name": "100\u202e5"}),
        ("/recipes", {"comment": "100\u202e5", "name": "n"}),
    ],
)
async def test_invisible_text_is_not_kept(
    engineer: httpx.AsyncClient, path: str, body: dict[str, str]
) -> None:
    response = await engineer.post(f"/api/v1/buses/dry-end{path}", json=body)
    check_problem(response, 422, "invalid")
    assert response.json()["detail"].startswith(f"{next(iter(body))}: character ")


@for_each(
    ("path", "form"),
    [
        ("/units/dry-end/1/block", {"reason": "a\0b"}),
        ("/sets/take", {"bus": "dry-end", "name": "a\0b"}),
        ("/recipes/save", {"bus": "dry-end", "name": "n", "comment": "a\0b"}),
    ],
)
async def test_nor_from_a_form(house: House, path: str, form: dict[str, str]) -> None:
    client = await house.signed_in(Role.ENGINEER)
    response = await client.post(path, data=form, headers={"Accept-Language": "de"})
    assert (response.status_code, "ist ein Steuerzeichen (U+0000)" in response.text) == (422, True)


async def test_a_unit_named_twice_is_refused(engineer: httpx.AsyncClient) -> None:
    response = await engineer.post("/api/v1/buses/dry-end/sets", json={"units": [1, 1]})
    check_problem(response, 422, "invalid")
    assert response.json()["detail"].startswith("units: 1 is given twice")


async def test_a_page_request_to_the_api_is_refused_in_the_users_language(house: House) -> None:
    german = {"accept-language": "de"}
    person, program = await house.signed_in(Role.VIEWER), await house.program(Role.VIEWER)
    assert (await person.get("/api/v1/nowhere", headers=german)).json()["detail"].startswith("unter /api/v1")
    assert (await program.get("/api/v1/nowhere", headers=german)).json()["detail"].startswith("there is")


def test_a_member_of_a_problem_may_have_the_name_of_a_parameter() -> None:
    """The result of a command has a ``message``, which is that of its unit."""
    members = {"message": {"code": "store_disk_failed", "params": {}}, "code": "x", "status": 1}
    assert Problem(503, "bus_closed", Message("store_disk_failed"), **members).extra == members


async def test_a_read_may_be_repeated_after_a_503_and_a_write_may_not(house: House) -> None:
    def away() -> None:
        raise Problem(503, "store", Message("shift_disk_full"))

    house.app.get("/healthz/away")(away)
    house.app.put("/healthz/away")(away)
    client = await house.program(Role.ENGINEER)
    read, write = await client.get("/healthz/away"), await client.put("/healthz/away")
    assert (read.status_code, read.headers["retry-after"]) == (503, "2")
    assert (write.status_code, write.headers.get("retry-after")) == (503, None)
