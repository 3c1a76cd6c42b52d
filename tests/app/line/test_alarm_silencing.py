"""One press silences every alarm that sounds, with one event, or none of them."""

from __future__ import annotations

import sqlite3

import pytest

from app.core.database import Database
from app.core.web.access import Person, Role
from app.errors import StoreError
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.site_alarms import SiteAlarms
from bus.instants import UnixTime
from tests.app.alarm_bus import BUS, RUN, AlarmBus

ANNA = Person("anna", Role.OPERATOR, "session")
UNITS = 255


class StandingAlarms:
    """The e-stops of 255 units, all active."""

    def __init__(self, database: Database) -> None:
        self.bus = AlarmBus(database, units=UNITS)
        self.bus.connect()
        site = SiteAlarms(self.bus.store, lambda: UnixTime(self.bus.now))
        events = self.bus.events
        self.alarms = LineAlarms(
            {BUS: self.bus.alarms}, site, self.bus.store, events, lambda: UnixTime(self.bus.now)
        )
        self.bus.now += 1
        self.bus.read(*range(1, UNITS + 1), inputs=RUN)


def entries(database: Database, query: str) -> list[tuple[object, ...]]:
    def read(connection: sqlite3.Connection) -> list[tuple[object, ...]]:
        return [tuple(row) for row in connection.execute(query)]

    return database.read_now(read)


async def test_every_alarm_that_sounds_is_silenced_in_one_transaction(database: Database) -> None:
    standing = StandingAlarms(database)
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


async def test_where_it_cannot_be_recorded_all_go_on_sounding(database: Database) -> None:
    standing = StandingAlarms(database)
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
    standing = StandingAlarms(database)
    await standing.alarms.silence_sounding(ANNA, UnixTime(standing.bus.now - 10))
    assert len(standing.alarms.sounding()) == UNITS
    assert entries(database, "SELECT count(*) FROM events WHERE kind = 'alarm'") == [(0,)]
