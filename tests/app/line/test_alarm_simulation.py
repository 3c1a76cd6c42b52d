"""Simulations over stored history against the engine that judged the same readings at their time. 5 s."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from pathlib import Path
from random import Random
from typing import Any

import pytest

from app.core.database import Database
from app.line.alarms.rules.state_machine import Transition
from app.line.alarms.settings import AlarmSettings
from app.line.alarms.simulation import Annunciations, Replay, StoredHour, extremes
from app.line.history import tables
from app.line.history.series.rollup import rollup
from app.line.history.series.runs import HOUR, MINUTE, micros, plain_run, runs_of
from bus.contract import Reading
from bus.instants import UnixTime
from tests.app.alarm_bus import AT_SPEED, BUS, HEALTHY, REMOTE, RUN, AlarmBus
from tests.app.history_line import NOON, Shelf, parameter

Values = dict[str, int]
Rule = dict[str, Any]
RULES: list[Rule] = [
    {"value": "actual", "above": 105},
    {"value": "actual", "below": 95, "deadband": 2, "on_delay_s": 4.2, "off_delay_s": 2},
    {"value": "actual", "above": 104, "below": 96, "deadband": 1, "on_delay_s": 30},
    {"value": "deviation", "above": 6, "off_delay_s": 5},
    {"value": "commanded", "below": 1},
    {"value": "analog", "above": 60, "deadband": 3, "latch": True},
    {"value": "run", "state": "off", "on_delay_s": 2},
    {"value": "output.2", "state": "on", "on_delay_s": 1, "off_delay_s": 4},
]


KINDS = ("steady", "drift", "noise", "stop", "estop", "bits", "lost")


@pytest.fixture
def shelf(tmp_path: Path) -> Iterator[Shelf]:
    shelf = Shelf(tmp_path / "history.db")
    yield shelf
    shelf.close()


def history_of(seed: int, minutes: int) -> Iterator[tuple[float, Values]]:
    """Readings of a unit that mostly runs steadily: disturbed, stopped, stepped and lost at times."""
    random, at = Random(seed), NOON
    fields = {
        "commanded": 1000,
        "actual": 1000,
        "analog": 51,
        "outputs": REMOTE | AT_SPEED,
        "inputs": RUN | HEALTHY,
    }
    steady = dict(fields)
    while at < NOON + minutes * 60:
        what = random.choice(
            ("steady", "steady", "steady", "drift", "noise", "stop", "estop", "bits", "lost")
        )
        length = random.choice((1.0, 7.0, 45.0, 200.0))
        if what == "lost":
            at += length
            continue
        for number in range(round(min(length, NOON + minutes * 60 - at) * 2)):
            fields = dict(steady)
            if what == "drift":
                fields |= {"actual": 1000 + number * random.choice((1, -1)), "analog": 51 + number % 30}
            elif what == "noise":
                fields["actual"] = 1000 + random.randrange(-80, 80)
            elif what == "stop":
                fields |= {"commanded": 0, "actual": max(0, 1000 - 50 * number)}
            elif what == "estop":
                fields |= {"inputs": RUN, "actual": 0}
            elif what == "bits":
                fields |= {"outputs": REMOTE | random.choice((0, 2)), "inputs": HEALTHY}
            yield round(at, 1), fields
            at += 0.5


def engine(
    database: Database, rules: list[Rule], readings: list[tuple[float, Values]]
) -> dict[str, list[float]]:
    """When the engine annunciated each."""
    bus = AlarmBus(database, *rules, units=1)
    bus.now = NOON - 10
    bus.connect()
    bus.apply(*(parameter(number, raw) for number, raw in ((22, 0), (23, 255))))
    for at, fields in readings:
        while bus.now < at - 0.5:
            bus.now += 0.5
            tick(bus)
        bus.now = at
        bus.read(1, **fields)
        tick(bus)
    entries, _ = bus.alarms.list.take_unwritten()
    found: dict[str, list[float]] = {}
    for each in entries:
        if each.after == "unack_active" != each.before:
            found.setdefault(each.name, []).append(float(each.at))
    return found


def tick(bus: AlarmBus) -> None:
    bus.alarms.list.advance(UnixTime(bus.now))
    bus.alarms.tick()


def simulated(
    shelf: Shelf, bus: AlarmBus, rule: Rule, minutes: int, start: float = NOON, end: float = inf
) -> Replay:
    settings = AlarmSettings(**{"name": "Own 0", "bus": BUS, "unit": 1, **rule})

    end = min(end, NOON + minutes * 60)

    def feed(connection: tables.StoreConnection) -> Replay:
        key = tables.find_unit(connection, BUS, 1)
        assert key is not None
        steps = tables.parameter_steps(connection, key)
        replay = Replay(bus.settings, settings, steps, UnixTime(start), UnixTime(end))
        first, last = micros(UnixTime(start)) // MINUTE * MINUTE, -(-micros(UnixTime(end)) // MINUTE) * MINUTE
        for begin in range(first, last, HOUR):
            hour = StoredHour(connection, shelf.tail, bus.settings, begin, min(begin + HOUR, last))
            hour.feed(replay, settings)
        return replay

    return shelf.database.read_now(feed)


def test_a_simulation_finds_what_the_engine_annunciated(tmp_path: Path, shelf: Shelf) -> None:
    """By every reading, in the tail and in the store."""
    minutes = 60
    readings = list(history_of(3, minutes))
    keep(shelf, readings)
    database = Database(tmp_path / "store.db")
    expected = engine(database, RULES, readings)
    bus = AlarmBus(database, units=1)
    recent = [simulated(shelf, bus, rule, minutes) for rule in RULES]
    shelf.fold()
    stored = [simulated(shelf, bus, rule, minutes) for rule in RULES]
    for index, replays in enumerate(zip(recent, stored, strict=True)):
        times = [[round(float(at), 3) for at in replay.found.at] for replay in replays]
        assert times[0] == times[1] == pytest.approx(expected[f"Own {index}"], abs=0.001)
        assert times[0]
        assert replays[1].unknown_s == pytest.approx(replays[0].unknown_s, rel=0.1)
    database.close()


def keep(shelf: Shelf, readings: list[tuple[float, Values]]) -> None:
    shelf.keep(parameter(number, raw) for number, raw in ((3, 1), (22, 0), (23, 255)))
    shelf.keep(Reading(1, UnixTime(at), **fields) for at, fields in readings)


def steadily(fields: dict[tuple[float, float], Values], minutes: int) -> list[tuple[float, Values]]:
    """A unit that runs at 100.0, but for some times (seconds)."""
    steady = {"commanded": 1000, "actual": 1000, "analog": 51}
    steady |= {"outputs": REMOTE | AT_SPEED, "inputs": RUN | HEALTHY}
    readings = []
    for half in range(minutes * 120):
        at = half / 2
        other = (more for (start, end), more in fields.items() if start <= at < end)
        readings.append((NOON + at, steady | next(other, {})))
    return readings


def test_a_rate_is_found_within_a_minute_and_over_its_end(tmp_path: Path, shelf: Shelf) -> None:
    """Ten minutes in which nothing changes are passed over; a jump between two minutes is not."""
    readings = steadily({(720, 900): {"actual": 1100}, (1230, 1231): {"actual": 900}}, 30)
    keep(shelf, readings)
    shelf.fold()
    database = Database(tmp_path / "store.db")
    rule = {"value": "actual", "change_per_s": 5}
    replay = simulated(shelf, AlarmBus(database, units=1), rule, 30)
    expected = engine(database, [rule], readings)["Own 0"]
    assert [at - NOON for at in replay.found.at] == pytest.approx([720, 900, 1230], abs=1)
    assert [at - NOON for at in expected] == pytest.approx([720, 900, 1230], abs=1)
    database.close()


def test_a_line_at_rest_needs_every_unit(tmp_path: Path, shelf: Shelf) -> None:
    stopped = {"commanded": 0, "actual": 0}
    keep(shelf, steadily({(600, 1200): stopped, (1500, 1800): stopped}, 40))
    other = steadily({(900, 2000): stopped}, 40)
    shelf.keep(Reading(2, UnixTime(at), **fields) for at, fields in other)
    shelf.fold()
    database = Database(tmp_path / "store.db")
    rule = {"value": "actual", "below": 80, "on_delay_s": 5}
    replay = simulated(shelf, AlarmBus(database, units=2), rule, 40)
    assert [at - NOON for at in replay.found.at] == [605]
    assert replay.found.lengths == [pytest.approx(295, abs=1)]
    alone = simulated(shelf, AlarmBus(database, units=3), rule, 40)
    assert [at - NOON for at in alone.found.at] == [605, 1505]
    database.close()


def test_the_extremes_of_a_minute_enclose_every_reading_of_it() -> None:
    random = Random(7)
    for _ in range(300):
        at, least = random.randrange(1000), random.randrange(200)
        readings = [
            Reading(
                1,
                UnixTime(at),
                random.randrange(least, 300),
                random.randrange(200),
                random.randrange(256),
                0,
                0,
            )
            for _ in range(4)
        ]
        low, high = extremes(1, "deviation", rollup(runs_of(map(plain_run, readings)), 0))
        found = [abs(each.commanded - each.actual) for each in readings]
        assert abs(low.commanded - low.actual) <= min(found)
        assert max(found) <= abs(high.commanded - high.actual)


def test_three_within_a_minute_chatter() -> None:
    found = Annunciations()
    for at in (0, 25, 59, 200, 250, 400):
        found.see([Transition(UnixTime(at), "rise", 1, "normal", "unack_active")])
        found.see([Transition(UnixTime(at + 5), "clear", 1, "unack_active", "rtn_unack")])
    assert (found.chattering, found.lengths) == (3, [5] * 6)
