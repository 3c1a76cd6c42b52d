"""A site that publishes, and a program apart that compares the plant's database with what the site serves.

It knows the interfaces alone: `/api/v1/history`, `/api/v1/events`, and the tables as they are documented.
"""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import psycopg

from app.line.history.service import History
from app.system.postgresql.publisher import Publisher
from bus.contract import ParameterValue, Reading, Update
from bus.instants import unix_now
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import until

UNITS = (1, 2)
NUMBERS = ("commanded", "actual", "analog")
BITS = (
    *("run", "estop", "preset", "reverse", "up", "down", "slave"),
    *(f"output.{number}" for number in range(1, 7)),
    *("remote", "at_speed"),
)
SCALES: list[Update] = [
    ParameterValue(unit, number, 1.0, raw) for unit in UNITS for number, raw in ((3, 1), (22, 0), (23, 510))
]
"""One decimal, and an analog input of 0 to 510."""


def write_configuration(
    folder: Path, url: str, readings: str, more: str = "", name: str = "Mill 7", unwind: str = "Unwind"
) -> Path:
    config = folder / "lineside.toml"
    folder.mkdir(exist_ok=True)
    config.write_text(
        f"""
[site]
name = "{name}"
[server]
data = "data"
[postgresql]
url = "{url}"
readings = "{readings}"
{more}
[[bus]]
name = "dry-end"
port = "/dev/null"
[[bus.unit]]
id = 1
name = "{unwind}"
labels.unit = "m/min"
labels.output.2 = "Brake"
[[bus.unit]]
id = 2
name = "Nip"
""",
        encoding="utf-8",
    )
    return config


@asynccontextmanager
async def publishing(
    folder: Path,
    url: str,
    readings: str = "all",
    more: str = "",
    name: str = "Mill 7",
    unwind: str = "Unwind",
) -> AsyncIterator[House]:
    """The app of a site with two units, which publishes."""
    config = write_configuration(folder, url, readings, more, name, unwind)
    async with complete_app(folder, config=config) as house:
        yield house


def reading(unit: int, at: float, actual: int, *, inputs: int = 0b11, outputs: int = 0xC0) -> Reading:
    return Reading(unit, at, 1000, actual, 51, outputs, inputs)


def keep(house: House, updates: Iterable[Update]) -> None:
    """As they come from the worker of the bus."""
    house.services[History].append("dry-end", list(updates))


def rows(url: str, query: str, *values: object) -> list[tuple[Any, ...]]:
    with psycopg.connect(url, autocommit=True) as connection:
        return connection.execute(query.encode(), values or None).fetchall()


async def published(house: House) -> None:
    """Wait until everything that is stored now is in the database."""
    await until(lambda: house.services[History].status.waiting == 0, "stored")
    now = unix_now()
    await until(lambda: house.services[Publisher].status.until > now, "published")


async def compare_readings(
    program: httpx.AsyncClient, url: str, start: float, end: float, step: float = 0.0
) -> int:
    """Compare the rows of a span with what the API serves, each value of each unit; return how many rows."""
    compared = 0
    for unit in UNITS:
        for value in (*NUMBERS, *BITS):
            query = {"bus": "dry-end", "unit": unit, "value": value, "points": 20_000, "format": "epoch"}
            span = {"from": iso(start), "to": iso(end)}
            response = await program.get("/api/v1/history", params={**query, **span})
            assert response.status_code == 200, response.text
            shown = response.json()
            assert shown["bucket_s"] == 0
            known = {
                round(at * 1e6): value
                for at, value in zip(shown["t"], shown["avg"], strict=True)
                if value is not None
            }
            if value in BITS:
                _compare_bit(url, unit, value, known, (start, end), round(step * 1e6))
                continue
            found = dict(_column(url, unit, value, start, end))
            expected = _last_of_steps(known, round(step * 1e6)) if step else known
            differing = sorted(set(found.items()) ^ set(expected.items()))
            assert not differing, f"{unit} {value}: {len(differing)} rows, {differing[:5]} of {len(expected)}"
            compared += len(found)
    return compared


def _column(url: str, unit: int, value: str, start: float, end: float) -> list[tuple[int, Any]]:
    name = value.replace(".", "_")
    query = (
        f"SELECT (extract(epoch FROM at) * 1000000)::bigint, {name} FROM lineside.reading"
        " WHERE bus = 'dry-end' AND unit = %s AND link = 'online'"
        " AND at >= to_timestamp(%s) AND at < to_timestamp(%s) ORDER BY at"
    )
    return [(at, value) for at, value in rows(url, query, unit, start, end)]


def _last_of_steps(known: dict[int, float], step: int) -> dict[int, float]:
    """The last value of each step; one that is steady between two points holds in each step between."""
    last: dict[int, float] = {}
    before: tuple[int, float] | None = None
    for at, value in sorted(known.items()):
        if before is not None and before[1] == value and before[0] // 60_000_000 == at // 60_000_000:
            last.update(dict.fromkeys(range(before[0] - before[0] % step, at, step), value))
        last[at - at % step] = value
        before = at, value
    return last


def _compare_bit(
    url: str, unit: int, value: str, known: dict[int, float], span: tuple[float, float], step: int
) -> None:
    """A bit is served by its changes: each row has the bit that was served for its time, or the end of its
    step."""
    times, bits = zip(*sorted(known.items()), strict=True)
    for at, is_on in _column(url, unit, value, *span):
        before = bisect_right(times, at + max(0, step - 1))
        assert before, f"{unit} {value} at {at}"
        assert bool(bits[before - 1]) is is_on, f"{unit} {value} at {at}"


async def compare_events(program: httpx.AsyncClient, url: str, first: int) -> int:
    """Compare the events from a number on with what the API serves; return how many."""
    served: list[dict[str, Any]] = []
    before = ""
    while True:
        page = (await program.get(f"/api/v1/events?limit=500{before}")).json()
        served += page["events"]
        if page["next"] is None:
            break
        before = f"&before={page['next']}"
    query = (
        "SELECT e.id, e.kind, e.who, e.bus, e.unit, e.what, coalesce(f.old, e.old), coalesce(f.new, e.new),"
        " e.old_raw, e.new_raw, coalesce(f.outcome, e.outcome)"
        " FROM lineside.event e LEFT JOIN lineside.event f ON f.site = e.site AND f.about = e.id"
        " WHERE e.about IS NULL AND e.id >= %s ORDER BY e.id DESC"
    )
    names = ("id", "kind", "who", "bus", "unit", "what", "old", "new", "old_raw", "new_raw", "outcome")
    expected = [tuple(each[name] for name in names) for each in served if each["id"] >= first]
    assert rows(url, query, first) == expected
    return len(expected)


def iso(at: float) -> str:
    return datetime.fromtimestamp(at, UTC).isoformat().replace("+00:00", "Z")


def minutes_ago(count: int) -> float:
    """The beginning of a minute, Unix time."""
    return (time.time() // 60 - count) * 60.0
