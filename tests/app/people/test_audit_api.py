"""``GET /api/v1/events`` as the contract has it, its CSV, and the page."""

from __future__ import annotations

import csv
import io
import sqlite3
from collections.abc import AsyncIterator
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.database import Database
from app.core.web.access import Role
from app.people.audit.log import EventLog
from bus.messages import Message
from bus.messages import number as decimal
from tests.app.complete_app import House, complete_app
from tests.app.intents import intend
from tests.for_each import for_each

CONTRACT = {"id", "time", "kind", "who", "bus", "unit", "what", "old", "new", "old_raw", "new_raw", "outcome"}


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path, time_zone="Europe/Berlin") as house:
        yield house


@pytest.fixture
async def viewer(house: House) -> httpx.AsyncClient:
    return await house.program(Role.VIEWER)


async def command(house: House, unit: int = 1, what: str = "set speed") -> int:
    fields: dict[str, Any] = {"who": "ann", "origin": "page", "bus": "dry-end", "unit": unit, "what": what}
    return await intend(house.services[EventLog], **fields, old="48.0", new="50.0", old_raw=480, new_raw=500)


async def test_a_command_with_its_outcome(house: House, viewer: httpx.AsyncClient) -> None:
    number = await command(house)
    await house.services[EventLog].conclude(number, "verified")
    response = (await viewer.get("/api/v1/events", params={"kind": "command"})).json()
    [event] = response["events"]
    assert set(event) >= CONTRACT
    assert response["next"] is None
    assert {name: event[name] for name in ("kind", "old", "new_raw", "outcome")} == {
        "kind": "command",
        "old": "48.0",
        "new_raw": 500,
        "outcome": "verified",
    }
    assert datetime.fromisoformat(event["time"]).tzinfo is not None


@for_each(
    "query",
    [
        "limit=0",
        "limit=1001",
        "limit=x",
        "before=0",
        "before=x",
        "unit=256",
        "from=2026-01-01T00:00:00",
        "to=x",
    ],
)
async def test_what_makes_no_sense_is_invalid(viewer: httpx.AsyncClient, query: str) -> None:
    response = await viewer.get(f"/api/v1/events?{query}")
    assert (response.status_code, response.json()["code"]) == (422, "invalid")


async def test_an_unknown_kind_is_refused_with_the_known_ones(viewer: httpx.AsyncClient) -> None:
    for path in ("/api/v1/events", "/api/v1/events.csv"):
        response = await viewer.get(path, params={"kind": "nope"})
        assert response.status_code == 422
        assert "'command'" in response.json()["detail"]
        assert (await viewer.get(path, params={"kind": "swap"})).status_code == 200


async def test_of_one_unit_or_of_a_span(house: House, viewer: httpx.AsyncClient) -> None:
    await command(house, unit=1)
    wanted = await command(house, unit=2)
    response = await viewer.get("/api/v1/events", params={"bus": "dry-end", "unit": 2})
    assert [(event["id"], event["outcome"]) for event in response.json()["events"]] == [(wanted, None)]
    await house.services[EventLog].record(kind="estop", what="then", at=1_700_000_000.0)
    span = {"from": "2023-11-14T22:13:20Z", "to": "2023-11-14T23:13:21+01:00"}
    response = await viewer.get("/api/v1/events", params=span)
    assert [event["what"] for event in response.json()["events"]] == ["then"]


async def test_csv_has_every_event_and_no_formula(house: House, viewer: httpx.AsyncClient) -> None:
    for number in range(1200):
        await house.services[EventLog].record(kind="secret", what=str(number))
    await house.services[EventLog].record(kind="secret", what="=HYPERLINK(1)", old="-5.0")
    response = await viewer.get("/api/v1/events.csv", params={"kind": "secret"})
    assert response.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(response.text)))
    assert len(rows) == 1201
    assert (rows[0]["what"], rows[0]["old"]) == ("'=HYPERLINK(1)", "-5.0")


async def test_an_admin_verifies_the_log(house: House) -> None:
    admin = await house.program(Role.ADMIN)
    number = await command(house)
    proof = (await admin.get("/api/v1/events/proof")).json()
    assert 0 <= proof.pop("anchored") <= number
    assert proof.pop("archived") == 0
    assert proof == {"entries": number, "broken": None, "fault": None, "unsealed": 0}

    def tamper(connection: sqlite3.Connection) -> None:
        connection.execute("DROP TRIGGER events_stay_as_written")
        connection.execute("UPDATE events SET new = '1' WHERE id = ?", (number,))

    await house.services[Database].write(tamper)
    proof = (await admin.get("/api/v1/events/proof")).json()
    assert (proof["broken"], proof["fault"]["code"]) == (number, "audit_entry_changed")


async def test_the_page_shows_and_filters(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    await command(house, what="set <speed>")
    page = await client.get(
        "/events", params={"kind": "command", "bus": "", "unit": "1", "since": "2000-01-01"}
    )
    assert page.status_code == 200
    assert "set &lt;speed&gt;" in page.text
    assert 'href="/units/dry-end/1"' in page.text
    other = await client.get("/events", params={"unit": "2"})
    assert "set &lt;speed&gt;" not in other.text


async def test_the_pages_days_are_days_at_the_site(house: House) -> None:
    """Half past midnight in Berlin is the evening before in UTC."""
    client = await house.signed_in(Role.VIEWER)
    at = datetime.fromisoformat("2026-03-02T00:30:00+01:00").timestamp()
    await house.services[EventLog].record(kind="estop", what="at half past midnight", at=at)
    assert "half past" in (await client.get("/events?since=2026-03-02&until=2026-03-02")).text
    assert "half past" not in (await client.get("/events?until=2026-03-01")).text
    csv_link = "from=2026-03-02T00%3A00%3A00%2B01%3A00"
    assert csv_link in (await client.get("/events?since=2026-03-02")).text


async def test_the_page_goes_on_to_older_ones(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    for number in range(120):
        await house.services[EventLog].record(kind="secret", what=f"thing-{number:03}")
    page = await client.get("/events?kind=secret")
    assert "thing-020" in page.text
    assert "thing-019" not in page.text
    older = page.text.split('href="/events?')[-1].split('"')[0].replace("&amp;", "&")
    assert "thing-019" in (await client.get(f"/events?{older}")).text


@for_each("query", ["unit=x", "before=x"])
async def test_the_page_passes_over_what_it_cannot_read(house: House, query: str) -> None:
    client = await house.signed_in(Role.VIEWER)
    assert (await client.get(f"/events?{query}")).status_code == 200


@for_each("query", ["since=nonsense", "until=11/21/2026"])
async def test_the_page_refuses_a_day_that_is_none_and_keeps_it(house: House, query: str) -> None:
    client = await house.signed_in(Role.VIEWER)
    refused = await client.get(f"/events?{query}")
    assert refused.status_code == 422
    assert "not a date or time" in refused.text
    assert f'value="{query.partition("=")[2]}"' in refused.text


async def test_a_german_reads_and_searches_numbers_in_german_writing(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    fields: dict[str, Any] = {"who": "ann", "origin": "page", "bus": "dry-end", "unit": 2, "what": "set"}
    number = await intend(house.services[EventLog], **fields, old=decimal("48.0"), new=decimal("1250.5"))
    message = Message.of("parameter_reads", value=decimal("48.0"))
    await house.services[EventLog].conclude(number, "unverified", message)
    for query in ("kind=command", "search=1250,5"):
        page = (await viewer.get(f"/events?{query}", headers={"Accept-Language": "de"})).text
        row = page.split(f'id="event-{number}"')[1].split("</tr>")[0]
        assert ("48,0" in row, "1250,5" in row, "48.0" in row) == (True, True, False)
    assert "48.0" in (await viewer.get("/events", headers={"Accept-Language": "en"})).text


async def test_what_people_have_named_and_written_is_not_translated(house: House) -> None:
    viewer = await house.signed_in(Role.VIEWER)
    fields: dict[str, Any] = {"who": "ann", "bus": "dry-end", "unit": 1}
    await house.services[EventLog].record(
        kind="control", what="control handed over", old="operator", new="user", **fields
    )
    await house.services[EventLog].record(kind="block", what="commands blocked", new="ramping", **fields)
    page = (await viewer.get("/events", headers={"Accept-Language": "de"})).text
    assert '<td class="event__old number">operator</td>' in page
    assert '<td class="event__new">user</td>' in page
    assert '<td class="event__new">ramping</td>' in page
