"""One change of several units is one row of the events page; API and CSV keep every event."""

from __future__ import annotations

import csv
import io
import re
import sqlite3
from pathlib import Path
from typing import Any

from app.core.database.migration import MIGRATIONS, bring_up_to_date
from app.core.web.access import Role
from app.people.audit.feature import MAX_PARTS, EventRow, page_of
from app.people.audit.log import EventLog, Filter, link_parts
from bus.messages import number as decimal
from tests.app.complete_app import House
from tests.app.fake_worker import PlayedWorker, responding
from tests.app.intents import intend


def intent(unit: int | None, what: str = "set speed", **more: Any) -> dict[str, Any]:
    return {"who": "ann", "origin": "page", "bus": "dry-end", "unit": unit, "what": what, **more}


async def change(house: House, units: int, *, failed: int | None = None, who: str = "ann") -> int:
    """A change of units 1 … n; the number of its event."""
    parts = [
        intent(n, f"set speed, one of {units}", old=decimal(f"{n}0.0"), new=decimal(f"{n}1.0"), who=who)
        for n in range(1, units + 1)
    ]
    group_entry = intent(
        None, f"set {units} units at once", who=who, old="1: 10.0, " * units, new="1: 11.0, " * units
    )
    log = house.services[EventLog]
    event, *numbers = await log.intend_together([group_entry, *parts], lambda c: link_parts(c, units))
    outcome = "verified" if failed is None else "unverified"
    results = dict.fromkeys(numbers, ("verified", ""))
    if failed is not None:
        results[numbers[failed - 1]] = ("unverified", f"unit {failed} did not respond")
    await log.conclude_together(results)  # type: ignore[arg-type]
    await log.conclude(event, outcome)
    return event


async def rows(house: House, limit: int = 100, **wanted: Any) -> tuple[list[EventRow], int | None]:
    return await page_of(house.services[EventLog], Filter(kind="command", **wanted), limit)


async def test_a_change_is_one_row_with_its_units_in_order(house: House) -> None:
    single = await intend(house.services[EventLog], **intent(2))
    group = await change(house, 3, failed=2)
    after = await intend(house.services[EventLog], **intent(1))
    found, more = await rows(house)
    assert [(row.event["id"], [part["unit"] for part in row.parts]) for row in found] == [
        (after, []),
        (group, [1, 2, 3]),
        (single, []),
    ]
    assert more is None
    assert found[1].outcomes == [("verified", 2), ("unverified", 1)]


async def test_rows_follow_the_times_shown_and_pages_the_numbers(house: House) -> None:
    log = house.services[EventLog]
    numbers = [await log.record(kind="worker", what="away", at=at) for at in (100.0, 130.0, 120.0, 140.0)]
    found, after = await page_of(log, Filter(kind="worker"), 3)
    assert [row.event["time"] for row in found] == [140, 130, 120]
    assert after == numbers[1]


async def test_a_part_found_without_its_change_is_a_separate_row(house: House) -> None:
    group = await change(house, 3)
    found, _ = await rows(house, unit=2)
    assert [(row.event["unit"], row.parts) for row in found] == [(2, [])]
    found, _ = await rows(house, who="ann")
    assert [row.event["id"] for row in found] == [group]
    found, _ = await rows(house, search="one of 3")
    assert [row.event["unit"] for row in found] == [3, 2, 1]


async def test_pages_have_complete_changes_and_nothing_twice(house: House) -> None:
    numbers = [await change(house, 3) for _ in range(5)]
    seen: list[int] = []
    before = None
    while True:
        found, before = await rows(house, 2, before=before)
        assert all(len(row.parts) == 3 for row in found)
        seen += [row.event["id"] for row in found]
        if before is None:
            break
    assert seen == numbers[::-1]


async def test_a_page_has_room_for_so_many_units_and_no_more(house: House) -> None:
    numbers = [await change(house, 255) for _ in range(5)]
    first, before = await rows(house)
    assert 0 < sum(len(row.parts) for row in first) <= MAX_PARTS
    assert {len(row.parts) for row in first} == {255}
    rest, after = await rows(house, before=before)
    assert [row.event["id"] for row in first + rest] == numbers[::-1]
    assert after is None


async def test_a_command_to_several_units_is_written_as_one_change(site: House, worker: PlayedWorker) -> None:
    worker.play = responding("verified")
    await site.request("POST", "/units/1/speed", {"raw": 90, "execute": True})
    await site.request("POST", "/speeds", {"setpoints": {"1": {"raw": 100}, "2": {"raw": 100}}})
    found, _ = await page_of(site.log, Filter(kind="command"), 10)
    assert [(row.event["unit"], [part["unit"] for part in row.parts]) for row in found] == [
        (None, [1, 2]),
        (1, []),
    ]


async def test_api_and_csv_keep_every_event(house: House) -> None:
    await change(house, 3)
    program = await house.program(Role.VIEWER)
    response = await program.get("/api/v1/events", params={"kind": "command"})
    assert [event["unit"] for event in response.json()["events"]] == [3, 2, 1, None]
    table = await program.get("/api/v1/events.csv", params={"kind": "command"})
    assert len(list(csv.DictReader(io.StringIO(table.text)))) == 4


async def test_the_page_has_one_row_and_each_units_values_and_result_in_it(house: House) -> None:
    await change(house, 2, failed=2)
    client = await house.signed_in(Role.VIEWER)
    page = (await client.get("/events", params={"kind": "command"})).text
    [row] = re.findall(r'<tr id="event-\d+" data-kind="command">.*?</details>.*?</tr>', page, re.DOTALL)
    spans = re.findall(r'<td class="event__\w+[^"]*"(?: colspan="(\d)")?', row)
    assert sum(int(span or 1) for span in spans) == 7, "each cell stands under its heading"
    text = re.sub(r"\s+", " ", re.sub("<[^>]+>", " ", row))
    assert "2 units: 1 verified, 1 not verified" in text
    assert "1 Unwind 10.0 → 11.0 verified" in text
    assert "2 Nip 20.0 → 21.0 not verified unit 2 did not respond" in text
    assert "1: 10.0" not in text, "the parts are not repeated in one long line"
    german = await house.signed_in(Role.VIEWER, "jo")
    page = (await german.get("/events", params={"kind": "command"}, headers={"Accept-Language": "de"})).text
    assert "2 Regler" in page
    assert "10,0 → 11,0" in page


async def test_long_values_of_one_event_stand_apart(house: House) -> None:
    long = ", ".join(f"{n}: 100.0" for n in range(1, 20))
    await intend(house.services[EventLog], **intent(None, "set 19 units at once", old=long, new=long))
    client = await house.signed_in(Role.VIEWER)
    page = (await client.get("/events", params={"kind": "command"})).text
    assert "Old and new values" in page
    assert '<td class="event__old number">' not in page


def test_a_store_of_an_earlier_version_has_its_changes_grouped(tmp_path: Path) -> None:
    path = tmp_path / "lineside.db"
    earlier = tmp_path / "migrations"
    earlier.mkdir()
    for step in MIGRATIONS.glob("*.sql"):
        if step.name < "0025":
            (earlier / step.name).write_text(step.read_text("utf-8"))
    connection = sqlite3.connect(path, isolation_level=None)
    bring_up_to_date(connection, path, earlier)
    one, other = (
        "set speed, one of 2 at once (82h, 83h)",
        "execute staged speed, with every unit (83h to all)",
    )
    change_one, change_other = "set 2 units at once (82h, 83h)", "execute every staged speed (83h to all)"
    written = [
        ("ann", None, change_one, None),
        ("ann", 1, one, None),
        ("ann", 2, one, None),
        ("ann", None, "", 1),
        ("ben", None, change_other, None),
        ("ben", 1, other, None),
        ("ben", 2, "set speed (84h)", None),
        ("eve", 3, one, None),
    ]
    for number, (who, unit, what, about) in enumerate(written, 1):
        kind = "command" if about is None else "fate"
        row = (number, kind, about, who, unit, what)
        connection.execute(
            """
            INSERT INTO events
            (id, time, kind, about, who, origin, bus, unit, what, message, frames, previous, hash)
            VALUES (?, 0, ?, ?, ?, 'page', 'dry-end', ?, ?, '', '[]', '', '')
            """,
            row,
        )
    bring_up_to_date(connection, path, MIGRATIONS)
    assert connection.execute("SELECT event, change FROM event_parts ORDER BY event").fetchall() == [
        (2, 1),
        (3, 1),
        (6, 5),
    ]


async def test_a_restore_that_ended_early_does_not_stand_still(house: House) -> None:
    """In German the word of a unit at rest is another than that of an ended act."""
    log = house.services[EventLog]
    await log.record(kind="restore", bus="dry-end", unit=1, what="restore", outcome="stopped")
    client = await house.signed_in(Role.VIEWER)
    for path in ("/events", "/shifts/present"):
        page = (await client.get(path, headers={"Accept-Language": "de"}, follow_redirects=True)).text
        results = re.findall(r'class="event__result[^"]*">\s*([^<]*?)\s*<', page)
        assert "vorzeitig beendet" in results, path
        assert "1 steht" not in page
