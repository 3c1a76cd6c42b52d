"""What people do with alarms: checked where it is done, recorded or undone as a whole, and kept through a
kill."""

from __future__ import annotations

import random
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from app.core.database import Database
from app.core.web.access import Person, Role
from app.errors import Problem, StoreError
from app.line.alarms.acts import (
    ACKNOWLEDGE,
    ALARM_ACTS,
    REMOVE,
    RESET,
    RETURN,
    SHELVE,
    SILENCE,
    UNSHELVE,
    ActBody,
    AlarmAct,
)
from app.line.alarms.journal import AlarmStore, JournalEntry
from app.line.alarms.line_alarms import LineAlarms, SiteAlarms
from app.people.audit.log import Filter
from bus.instants import UnixTime
from tests.app.alarm_bus import BUS, RUN, AlarmBus
from tests.app.complete_app import EVERY_ROLE
from tests.sizes import sizes

ESTOP = f"{BUS}.1.estop_active"
ANNA = Person("anna", Role.ENGINEER, "session")
UNITS = 64


class ActiveAlarms:
    """Emergency stops that are active: of each of some units."""

    def __init__(self, database: Database, units: int = 1) -> None:
        self.bus = AlarmBus(database, units=units)
        self.bus.connect()
        self.alarm = self.bus.alarm("1.estop_active")
        self.events = self.bus.events
        site = SiteAlarms(self.bus.store, lambda: UnixTime(self.bus.now))
        self.alarms = LineAlarms({BUS: self.bus.alarms}, site, self.bus.store, self.events, self.clock)
        self.bus.now += 1
        self.bus.read(*range(1, units + 1), inputs=RUN)

    def clock(self) -> UnixTime:
        return UnixTime(self.bus.now)

    async def recorded(self) -> list[tuple[str, str | None, int | None]]:
        events, _ = await self.events.page(Filter(kind="alarm"), 100)
        return [(event["what"], event["message"], event["unit"]) for event in events]


def body_of(act: AlarmAct) -> ActBody:
    fields = {"reason": "chatters", "minutes": 5, "comment": "seen"}
    return act.body(**{name: fields[name] for name in fields.keys() & act.body.model_fields.keys()})


@pytest.mark.parametrize(
    ("act", "role"), [(act, role) for act in ALARM_ACTS for role in EVERY_ROLE if not role.includes(act.role)]
)
async def test_a_caller_without_a_route_needs_the_role_too(
    database: Database, act: AlarmAct, role: Role
) -> None:
    active = ActiveAlarms(database)
    before = active.alarm.facts
    with pytest.raises(Problem, match=f"role {act.role}") as refused:
        await active.alarms.act(Person("ben", role, "session"), act, f"{ESTOP}.1", body_of(act))
    assert (refused.value.status, refused.value.code) == (403, "forbidden")
    assert active.alarm.facts is before
    assert await active.recorded() == []


async def test_each_act_follows_from_its_row(database: Database) -> None:
    active = ActiveAlarms(database)
    expected = [
        (SILENCE, "unack_active"),
        (ACKNOWLEDGE, "ack_active"),
        (SHELVE, "shelved"),
        (UNSHELVE, "unack_active"),
        (REMOVE, "out_of_service"),
        (RETURN, "unack_active"),
    ]
    for act, state in expected:
        await active.alarms.act(ANNA, act, f"{ESTOP}.1", body_of(act))
        assert active.alarm.facts.state == state
    assert active.alarm.hidden_by == "anna"
    assert await active.recorded() == [
        ("Alarm returned to service: Emergency stop", "chatters", 1),
        ("Alarm taken out of service: Emergency stop", "chatters", 1),
        ("Alarm unshelved: Emergency stop", "chatters", 1),
        ("Alarm shelved: Emergency stop", "chatters", 1),
        ("Alarm acknowledged: Emergency stop", "seen", 1),
        ("Alarm silenced: Emergency stop", "seen", 1),
    ]
    with pytest.raises(Problem, match="Nothing was changed"):
        await active.alarms.act(ANNA, RESET, f"{ESTOP}.1")


def entries(database: Database, query: str) -> list[tuple[object, ...]]:
    def read(connection: sqlite3.Connection) -> list[tuple[object, ...]]:
        return [tuple(row) for row in connection.execute(query)]

    return database.read_now(read)


async def test_every_alarm_that_sounds_is_silenced_in_one_transaction(database: Database) -> None:
    standing = ActiveAlarms(database, UNITS)
    until = UnixTime(standing.bus.now)
    standing.bus.now += 1
    standing.bus.read(7, inputs=RUN | 0b10)
    standing.bus.read(7, inputs=RUN, at=standing.bus.now + 0.1)
    commits = []
    database._connection.set_trace_callback(lambda text: commits.append(text) if text == "COMMIT" else None)
    await standing.alarms.silence_sounding(ANNA, until)
    assert len(commits) == 1
    assert [alarm.definition.unit for alarm in standing.alarms.sounding()] == [7], "which came since"
    silenced = "SELECT count(*), count(DISTINCT alarm) FROM alarm_journal WHERE trigger = 'silence'"
    assert entries(database, silenced) == [(UNITS - 1, UNITS - 1)]
    assert entries(database, "SELECT count(*) FROM alarm_facts WHERE silenced = 1") == [(UNITS - 1,)]
    (event,) = entries(database, "SELECT who, bus, unit FROM events WHERE kind = 'alarm'")
    assert event == ("anna", BUS, None)


async def test_when_silencing_cannot_be_recorded_all_alarms_go_on_sounding(database: Database) -> None:
    standing = ActiveAlarms(database, UNITS)
    await standing.bus.alarms.list.write()
    (pages,) = database._connection.execute("PRAGMA page_count").fetchone()
    database._connection.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(StoreError):
        await standing.alarms.silence_sounding(ANNA, UnixTime(standing.bus.now))
    assert len(standing.alarms.sounding()) == UNITS
    database._connection.execute("PRAGMA max_page_count = 1000000")
    await standing.bus.alarms.list.write()
    triggers = entries(database, "SELECT DISTINCT trigger FROM alarm_journal")
    assert triggers == [("rise",)]
    assert entries(database, "SELECT count(*) FROM events WHERE kind = 'alarm'") == [(0,)]


async def test_a_press_with_nothing_to_silence_is_no_event(database: Database) -> None:
    standing = ActiveAlarms(database, UNITS)
    await standing.alarms.silence_sounding(ANNA, UnixTime(standing.bus.now - 10))
    assert len(standing.alarms.sounding()) == UNITS
    assert entries(database, "SELECT count(*) FROM events WHERE kind = 'alarm'") == [(0,)]


def flood_and_kill(store: Path, passes: int) -> None:
    """Let it write some passes, then kill it in the next."""
    command = [sys.executable, "-m", "tests.app.alarm_flood", str(store)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as flood:
        assert flood.stdout is not None
        for _ in range(passes):
            assert flood.stdout.readline() == "written\n"
        flood.kill()


def check_chain(entries: list[JournalEntry]) -> None:
    """Each transition of an alarm begins where the one before ended, and no occurrence is left out."""
    state, occurrence = "normal", 0
    for entry in entries:
        assert entry.before == state
        occurrence += entry.trigger == "rise"
        assert entry.occurrence == occurrence
        state = entry.after


@pytest.mark.parametrize("kills", sizes(1, 50))
async def test_a_kill_in_a_flood_loses_and_repeats_no_transition(tmp_path: Path, kills: int) -> None:
    path = tmp_path / "store.db"
    dice = random.Random(14)
    for _ in range(kills):
        flood_and_kill(path, dice.randint(3, 12))
    database = Database(path)
    store = AlarmStore(database)
    journal = await store.journal(1_000_000, None)
    stored = await store.load()
    database.close()
    by_alarm: dict[str, list[JournalEntry]] = {}
    for entry in reversed(journal):
        by_alarm.setdefault(entry.alarm, []).append(entry)
    assert len(journal) > 50
    for key, entries in by_alarm.items():
        check_chain(entries)
        assert (stored[key].facts.state, stored[key].facts.occurrence) == (
            entries[-1].after,
            entries[-1].occurrence,
        )
