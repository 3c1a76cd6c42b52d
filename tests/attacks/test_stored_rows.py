"""Hostile rows in the store, written directly or by a worker, break no page: what cannot be read is
marked.
"""

from __future__ import annotations

import csv
import io
import sqlite3
from pathlib import Path
from typing import Any

from app.core.database import Database
from app.core.web.access import Role
from app.people.audit.entry import new_entry
from app.people.audit.log import EventLog
from tests.app.complete_app import House, complete_app

FRAME = '{"at":%s,"direction":"in","data":"10 02","meaning":"x"}'
HOSTILE: dict[str, dict[str, Any]] = {
    "infinite time": {"time": float("inf")},
    "time before any date": {"time": -1e300},
    "time after every date": {"time": 1e18},
    "frames that are no JSON": {"frames": "{"},
    "frames that are no list": {"frames": "17"},
    "frames that are no frames": {"frames": "[1, {}, null]"},
    "frames of no time": {"frames": f"[{FRAME % '1e999'}]"},
    "frames of not a number": {"frames": f"[{FRAME % 'NaN'}]"},
    "frames in one another": {"frames": "[" * 200_000},
    "a result that is none": {"outcome": "{{ 7 * 7 }}\x00<script>", "kind": "command"},
    "a kind that there is not": {"kind": "../../x", "what": "<b>"},
    "a unit that there is not": {"bus": "no/such?bus", "unit": 2**62, "old_raw": -(2**63)},
    "a text without an end": {"what": "a: b; c, " * 5_000, "message": ": " * 200},
    "sentences in one another": {"what": "a: b; c, " * 44, "old": "{x}", "new": "{0.__class__}"},
    "messages that are no JSON": {"messages": "{"},
    "messages that are no messages": {"messages": '{"what": 17}'},
    "messages in one another": {"messages": '{"what":{"code":"x","params":{"a":' * 10_000},
    "a message that there is not": {"messages": '{"what":{"code":"no_such","params":{"a":"<script>"}}}'},
    "a message without its values": {"messages": '{"what":{"code":"event_write_parameter","params":{}}}'},
    "a message of no number": {"messages": '{"what":{"code":"x","params":{"a":1e999}}}'},
    "half a character": {"what": "\ud800", "who": "\udfff"},
}


SHOWN_AS_CODES = {"a message that there is not", "a message without its values"}


async def put(house: House, *rows: dict[str, Any]) -> list[int]:
    """Write rows past the log, as they are; their ids."""

    def work(connection: sqlite3.Connection) -> list[int]:
        numbers = []
        for row in rows:
            columns = {**new_entry(kind="estop", time=1_700_000_000.0, what="fine"), **row}
            text = {
                name: value.encode("utf-8", "surrogatepass")
                for name, value in columns.items()
                if isinstance(value, str)
            }
            (last,) = connection.execute("SELECT max(id) FROM events").fetchone()
            numbers.append(last + 1)
            columns |= {"id": last + 1, "previous": b"x", "hash": b"x", **text}
            marks = ", ".join(
                "CAST(? AS TEXT)" if isinstance(value, bytes) else "?" for value in columns.values()
            )
            connection.execute(
                f"INSERT INTO events ({', '.join(columns)}) VALUES ({marks})", [*columns.values()]
            )
        return numbers

    return await house.services[Database].write(work)


async def look(house: House) -> dict[int, dict[str, Any]]:
    """Every view of the events; the rows of the API by id."""
    page = await house.signed_in(Role.ADMIN)
    for language in ("en", "de"):
        response = await page.get("/events", headers={"Accept-Language": language})
        assert response.status_code == 200, language
        assert "<script>" not in response.text.partition("<main")[2]
    file = await page.get("/api/v1/events.csv")
    assert file.status_code == 200
    listed = await page.get("/api/v1/events", params={"limit": 1000})
    assert listed.status_code == 200
    span = {"from": "2023-11-14T00:00:00Z", "to": "2023-11-15T00:00:00Z"}
    for path, query in (("events", span), ("history/marks", span), ("events/proof", {})):
        response = await page.get(f"/api/v1/{path}", params=query)
        assert response.status_code == 200, response.text
    rows = {event["id"]: event for event in listed.json()["events"]}
    csv.field_size_limit(10_000_000)
    assert {int(row["id"]) for row in csv.DictReader(io.StringIO(file.text))} == rows.keys()
    return rows


async def test_impossible_rows(house: House) -> None:
    before, *hostile, after = await put(house, {}, *HOSTILE.values(), {})
    rows = await look(house)
    assert rows[before]["what"] == rows[after]["what"] == "fine"
    assert {name for name, number in zip(HOSTILE, hostile, strict=True) if rows[number]["unreadable"]} == {
        name for name, row in HOSTILE.items() if {"time", "frames", "messages"} & row.keys()
    } - SHOWN_AS_CODES
    assert {name for name, number in zip(HOSTILE, hostile, strict=True) if rows[number]["time"] is None} == {
        name for name, row in HOSTILE.items() if "time" in row
    }


async def test_an_impossible_result(house: House) -> None:
    """The entry of a result is joined to that of its command."""
    [command] = await put(house, {"kind": "command", "bus": "dry-end", "unit": 1})
    await put(
        house, {"kind": "fate", "about": command, "time": float("inf"), "frames": "[[", "outcome": "verified"}
    )
    rows = await look(house)
    assert (rows[command]["unreadable"], rows[command]["outcome"]) == (True, "verified")


async def test_the_server_starts_on_such_rows(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        await put(house, *HOSTILE.values())
        await put(house, {"kind": "command", "time": float("inf"), "frames": "{"})
    async with complete_app(tmp_path) as house:
        assert (await look(house)).keys()


async def test_what_the_server_itself_records_stays_readable(house: House) -> None:
    """A time that a worker gave, or half a character that JSON can carry."""
    events = house.services[EventLog]
    numbers = [
        await events.record(kind="unit", what="unit offline", at=at, message="\ud800")
        for at in (float("inf"), float("-inf"), float("nan"), -1.0, 1e18)
    ]
    rows = await look(house)
    assert [rows[number]["unreadable"] for number in numbers] == [False] * 5
    proof = (await (await house.program(Role.ADMIN)).get("/api/v1/events/proof")).json()
    assert proof["fault"] is None
