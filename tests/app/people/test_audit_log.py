"""The event log: on disk before anything is sent, never changed, every command with one outcome."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import AsyncIterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from app.core.database import Database
from app.errors import ConstraintError
from app.people.audit.log import ENDED_BEFORE, Event, EventLog, Filter, Logged
from bus.contract import Frame
from bus.messages import Message, term
from tests.app.intents import intend
from tests.for_each import for_each


class Clock:
    """A clock that is set by hand."""

    now = 1000.0

    def __call__(self) -> float:
        self.now += 1
        return self.now


@pytest.fixture
async def database(tmp_path: Path) -> AsyncIterator[Database]:
    opened = Database(tmp_path / "lineside.db")
    yield opened
    opened.close()


@pytest.fixture
def log(database: Database) -> EventLog:
    return EventLog(database, Clock())


async def intent(log: EventLog, unit: int = 1, **fields: Any) -> int:
    entry: dict[str, Any] = {"who": "ann", "origin": "api", "bus": "dry-end", "what": "set speed", **fields}
    return await intend(log, **entry, unit=unit, old="48.0", new="50.0", old_raw=480, new_raw=500)


async def newest(log: EventLog, **wanted: Any) -> list[Event]:
    return (await log.page(Filter(**wanted), 100))[0]


async def test_an_intent_is_on_disk_when_it_returns(log: EventLog, database: Database) -> None:
    await intent(log)
    with closing(sqlite3.connect(f"file:{database.path}?mode=ro", uri=True)) as other:
        assert other.execute("SELECT what, new_raw, outcome FROM events").fetchall() == [
            ("set speed", 500, None)
        ]


async def test_an_outcome_is_merged_into_its_command(log: EventLog) -> None:
    number = await intent(log)
    frame = Frame(at=1.5, direction="out", data=b"\x10\x02", meanings=[term("81h")])
    await log.conclude(number, "verified", "reads 50.0", [frame])
    [event] = await newest(log)
    assert (event["id"], event["outcome"], event["message"]) == (number, "verified", "reads 50.0")
    assert (event["time"], event["concluded_at"]) == (1001.0, 1002.0)
    assert json.loads(event["frames"])[0]["data"] == "10 02"


async def test_a_message_is_stored_as_its_text_and_its_params(log: EventLog) -> None:
    number = await intent(log)
    what = Message.of("event_role_changed", name="half \ud800", role=term("viewer"))
    await log.record(kind="user", what=what, old="typed")
    await log.conclude(number, "verified", Message("unit_not_remote"))
    later, first = await newest(log)
    assert later["what"] == "user half \\ud800 is now viewer"
    assert later["messages"]["what"].params == {"name": "half \\ud800", "role": term("viewer")}
    assert (later["old"], "old" in later["messages"]) == ("typed", False)
    assert first["message"] == "unit is not in REMOTE mode"
    assert first["messages"] == {"message": Message("unit_not_remote")}
    assert (await log.proof.verify()).broken is None


async def test_a_command_has_one_outcome(log: EventLog) -> None:
    number = await intent(log)
    await log.conclude(number, "verified")
    with pytest.raises(ConstraintError):
        await log.conclude(number, "refused")
    assert [event["outcome"] for event in await newest(log)] == ["verified"]


async def test_what_a_dead_server_left_open_is_unverified(log: EventLog) -> None:
    done, left = await intent(log), await intent(log)
    await log.conclude(done, "acknowledged")
    await log.record(kind="login", what="logged in", who="ann")
    assert await log.close_open_intents() == 1
    assert await log.close_open_intents() == 0
    events = {event["id"]: event for event in await newest(log, kind="command")}
    assert events[done]["outcome"] == "acknowledged"
    assert (events[left]["outcome"], events[left]["message"]) == ("unverified", str(ENDED_BEFORE))


async def test_an_open_command_with_an_unreadable_text_stops_no_start(
    log: EventLog, database: Database
) -> None:
    seen = list[Logged]()
    log.subscribe(seen.append)
    await intent(log, what="x")
    with closing(sqlite3.connect(database.path)) as other, other:
        other.execute("DROP TRIGGER events_stay_as_written")
        other.execute("UPDATE events SET what = CAST(x'ff' AS TEXT)")
    assert await log.close_open_intents() == 1
    assert [event.outcome for event in seen] == [None, "unverified"]


@for_each(
    ("change", "reason"),
    [
        ("UPDATE events SET what = 'x' WHERE id = 1", "an event is never"),
        ("DELETE FROM events", "an event is never"),
        ("DELETE FROM events_head", "the head of the log"),
        ("UPDATE events_head SET id = 1", "the head of the log"),
        ("UPDATE events_head SET hash = 'x'", "the head of the log"),
    ],
)
async def test_nothing_is_changed_or_removed(
    log: EventLog, database: Database, change: str, reason: str
) -> None:
    await intent(log)
    with pytest.raises(ConstraintError, match=reason):
        await database.write(lambda connection: connection.execute(change))
    assert (await log.proof.verify()).broken is None


async def test_pages_go_back_to_the_beginning_without_a_gap(log: EventLog) -> None:
    for number in range(25):
        await log.record(kind="x", what=str(number))
    seen: list[str] = []
    before: int | None = None
    while True:
        found, before = await log.page(Filter(before=before), 10)
        seen += [event["what"] for event in found]
        if before is None:
            break
    assert seen == [str(number) for number in reversed(range(25))]


async def test_a_cursor_stands_still_while_events_come(log: EventLog) -> None:
    for number in range(4):
        await log.record(kind="x", what=str(number))
    _, after = await log.page(Filter(), 2)
    await log.record(kind="x", what="new")
    assert [event["what"] for event in await newest(log, before=after)] == ["1", "0"]


async def test_filters(log: EventLog) -> None:
    await log.record(kind="login", what="in", who="ann", message="with her secret")
    await log.record(kind="unit_lost", what="lost 100%", bus="a", unit=1)
    await log.record(kind="unit_back", what="back", bus="a", unit=2)
    wanted: dict[str, list[dict[str, Any]]] = {
        "in": [{"kind": "login"}, {"who": "ann"}, {"search": "secret"}],
        "lost 100%": [{"since": 1002.0, "until": 1003.0}, {"search": "OST"}, {"search": "100%"}],
        "back": [{"bus": "a", "unit": 2}],
        "": [{"search": "0_%"}],
    }
    for what, filters in wanted.items():
        for each in filters:
            assert [event["what"] for event in await newest(log, **each)] == ([what] if what else []), each
    assert len(await newest(log, bus="a")) == 2


async def test_the_message_of_an_outcome_is_searched_too(log: EventLog) -> None:
    number = await intent(log)
    await log.conclude(number, "refused", "unit is not in REMOTE mode")
    assert [event["id"] for event in await newest(log, search="not in remote")] == [number]


async def test_subscribers_get_the_event_and_its_outcome(log: EventLog) -> None:
    received: list[tuple[int, str | None]] = []
    end = log.subscribe(lambda event: received.append((event.id, event.outcome)))
    number = await intent(log)
    await log.conclude(number, "verified")
    end()
    await log.record(kind="x", what="unheard")
    assert received == [(number, None), (number, "verified")]


async def test_a_subscriber_that_fails_affects_no_other(log: EventLog) -> None:
    received: list[int] = []

    def fail(_: Logged) -> None:
        raise ZeroDivisionError

    log.subscribe(fail)
    log.subscribe(lambda event: received.append(event.id))
    assert await log.record(kind="x", what="y") == 1
    assert received == [1]


async def test_a_message_that_this_version_does_not_have_is_shown_as_it_was_stored(
    log: EventLog, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.people.audit.entry._KNOWN", {"term"})
    await log.record(kind="server", what=Message("event_server_started"), old=term("stopped"))
    [event] = await newest(log)
    assert event["what"] == "server started"
    assert list(event["messages"]) == ["old"]
