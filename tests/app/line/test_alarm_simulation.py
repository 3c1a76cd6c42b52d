"""Simulations over stored history: against the engine that judged the same readings at their time, over HTTP,
and on the page. 8 s."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from math import inf
from pathlib import Path
from random import Random
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.core.database import Database
from app.core.web.access import Role
from app.errors import Problem
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.own_condition import in_toml, proposed
from app.line.alarms.rules import Transition
from app.line.alarms.settings import AlarmSettings
from app.line.alarms.simulation import Annunciations, Replay, Simulator, StoredHour, extremes
from app.line.history import tables
from app.line.history.series.runs import HOUR, MINUTE, micros, plain_run, rollup, runs_of
from app.line.history.service import History
from app.settings import load
from bus.contract import ParameterValue, Reading
from bus.instants import UnixTime
from tests.app.alarm_bus import AT_SPEED, BUS, HEALTHY, REMOTE, RUN, AlarmBus
from tests.app.complete_app import House, complete_app
from tests.app.history_line import NOON, Shelf, parameter, until
from tests.for_each import for_each

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
    entries, _ = bus.alarms.list.pop_unwritten()
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
    minutes = 30
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


def test_a_rate_of_change_is_found_within_a_minute_and_across_its_end(tmp_path: Path, shelf: Shelf) -> None:
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


def test_three_annunciations_within_a_minute_chatter() -> None:
    found = Annunciations()
    for at in (0, 25, 59, 200, 250, 400):
        found.see([Transition(UnixTime(at), "rise", 1, "normal", "unack_active")])
        found.see([Transition(UnixTime(at + 5), "clear", 1, "unack_active", "rtn_unack")])
    assert (found.chattering, found.lengths) == (3, [5] * 6)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(start=st.integers(0, 5000), length=st.integers(1, 6000))
def test_a_simulation_has_nothing_from_outside_of_its_time(
    fast_shelf: Shelf, start: int, length: int
) -> None:
    """Tenths of a second; complete minutes are read, and both ends are within one."""
    begin, end = NOON + start / 10, NOON + (start + length) / 10
    with closing(Database(fast_shelf.database.path.with_name("alarms.db"))) as database:
        bus = AlarmBus(database, units=1)
        replay = simulated(
            fast_shelf, bus, {"value": "actual", "above": 105, "on_delay_s": 3}, 20, begin, end
        )
    replay.end(UnixTime(end))
    replay.found.end(UnixTime(end))
    assert 0 <= replay.unknown_s <= length / 10 + 0.001
    assert [at for at in replay.found.at if not begin <= at <= end] == []
    assert [each for each in replay.found.lengths if each < 0] == []


@pytest.fixture(scope="module")
def fast_shelf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shelf]:
    """Ten minutes of a unit that is too fast at times, and does not respond for the third."""
    shelf = Shelf(tmp_path_factory.mktemp("shelf") / "history.db")
    fast = {(start, start + 8.0): {"actual": 1100} for start in range(0, 600, 25)}
    keep(shelf, [each for each in steadily(fast, 10) if not 120 <= each[0] - NOON < 180])
    yield shelf
    shelf.close()


PATH = "/api/v1/alarms/simulate"
ABOVE = {"bus": BUS, "unit": 1, "value": "actual", "above": "105.0"}


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    """Unit 1 ran at 100.0 in the last ten minutes, three times too fast for 2 s within half a minute."""
    async with complete_app(tmp_path) as house:
        now = time.time() - 600
        fast = [*range(60, 62), *range(70, 72), *range(80, 82)]
        readings = [
            Reading(1, UnixTime(now + second), 1000, 1100 if second in fast else 1000, 51, 0xC0, 3)
            for second in range(600)
        ]
        history = house.services[History]
        history.append(BUS, [ParameterValue(1, 3, UnixTime(now - 1), 1), *readings])
        await asyncio.to_thread(until, lambda: history.status.waiting == 0)
        yield house


async def simulation_by(client: httpx.AsyncClient, **body: Any) -> dict[str, Any]:
    response = await client.post(PATH, json={**ABOVE, **body})
    assert response.status_code == 200, response.text
    found: dict[str, Any] = response.json()
    return found


async def test_an_engineer_learns_how_often_it_would_have_come(house: House) -> None:
    engineer = await house.program(Role.ENGINEER)
    found = await simulation_by(engineer)
    assert (found["annunciated"], found["chattering"], found["complete"]) == (3, 3, True)
    assert (found["standing_s"], found["longest_s"], found["stands_at_end"]) == (6, 2, False)
    assert found["covered_from"] > found["from"]
    assert found["first"] < found["last"] < found["covered_to"]
    assert (await simulation_by(engineer, on_delay_s=5))["annunciated"] == 0
    assert (await simulation_by(engineer, off_delay_s=20, above=105))["annunciated"] == 1
    other = await simulation_by(engineer, unit=2)
    assert (other["covered_from"], other["annunciated"], other["unknown_s"]) == (None, 0, 0)
    past = await simulation_by(engineer, **{"from": "2020-01-01T00:00:00Z", "to": "2020-01-02T00:00:00Z"})
    assert past["covered_from"] is None
    unscaled = await simulation_by(engineer, value="analog")
    assert (unscaled["annunciated"], unscaled["unknown_s"]) == (0, pytest.approx(600, abs=70))
    assert not house.services[LineAlarms].buses[BUS].list.pop_unwritten()[0]


async def test_readings_that_are_stored_no_longer_are_not_judged(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    engineer = await house.program(Role.ENGINEER)
    before = await simulation_by(engineer)
    given_up = micros(UnixTime(time.time() - 525))
    monkeypatch.setattr(tables, "raw_from", lambda _: given_up)
    after = await simulation_by(engineer)
    assert (before["annunciated"], after["annunciated"]) == (3, 1)
    assert before["covered_from"] < after["covered_from"] < after["first"]


@for_each(
    ("body", "words"),
    [
        ({"unit": 9}, "bus dry-end has no unit 9"),
        ({"above": "10", "deadband": "11"}, "deadband is wider than the limits leave room for"),
        ({"above": "fast"}, "above = 'fast'"),
        ({"from": "2026-01-01T00:00:00Z", "to": "2026-03-01T00:00:00Z"}, "at most 31 days at once"),
        ({"from": "2026-01-02T00:00:00Z", "to": "2026-01-01T00:00:00Z"}, ""),
    ],
)
async def test_a_fault_of_the_simulated_alarm_is_named(
    house: House, body: dict[str, Any], words: str
) -> None:
    engineer = await house.program(Role.ENGINEER)
    response = await engineer.post(PATH, json={**ABOVE, **body})
    assert response.status_code == 422
    assert words in response.json()["detail"]


def test_a_key_that_is_missing_is_named_alone() -> None:
    with pytest.raises(Problem) as refused:
        proposed({"name": "Web break", "bus": "dry-end", "unit": 1}, [])
    assert str(refused.value.message) == "value is missing"


async def test_the_work_of_a_simulation_is_bounded_and_the_response_says_so(house: House) -> None:
    history = house.services[History]
    settings = AlarmSettings(name="x", **{**ABOVE, "value": "actual"})
    now = UnixTime(time.time())
    found = await Simulator(history, work_s=0.0).run(
        history.buses[BUS], settings, UnixTime(now - 3600), now, "anna"
    )
    assert (found.complete, found.covered_to, found.annunciated) == (False, found.covered_from, 0)


async def test_the_page_has_the_form_the_result_and_the_entry(house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    query = {"place": f"{BUS}/1", "value": "actual", "above": "105.0", "days": "1", "name": "Too fast"}
    page = (await engineer.get("/alarms/own", params=query)).text
    assert "The alarm would have come 3 times. 3 of them chattering." in page
    assert "History begins at" in page
    assert "name = &#34;Too fast&#34;" in page
    german = {"Accept-Language": "de"}
    comma = query | {"above": "105,0"}
    assert "would have come 3 times." in (await engineer.get("/alarms/own", params=comma)).text
    page = (await engineer.get("/alarms/own", params=comma, headers=german)).text
    assert "Der Alarm wäre 3-mal gekommen." in page
    for change, words in (
        ({"on_delay_s": "-1"}, "On-delay, s = -1: "),
        ({"place": f"{BUS}/9"}, "has no unit 9"),
        ({"on_delay_s": "soon"}, "On-delay, s = soon: "),
    ):
        refused = await engineer.get("/alarms/own", params=query | change)
        assert (refused.status_code, words in refused.text) == (422, True)
        assert 'value="Too fast"' in refused.text
    refused = await engineer.get("/alarms/own", params=query | {"above": "abc"}, headers=german)
    assert "Über = abc: eine endliche Zahl schreiben" in refused.text


async def test_nothing_stored_is_not_zero_on_the_page(house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER)
    page = (await engineer.get("/alarms/own", params={"place": f"{BUS}/2", "above": "1"})).text
    assert "Nothing of this time is stored." in page
    assert "The alarm would have come" not in page


def test_the_entry_can_be_pasted_into_the_configuration(tmp_path: Path) -> None:
    written = {"name": 'A "quoted" \\ name', "bus": BUS, "unit": 4, "value": "deviation", "above": "2.50"}
    written |= {"deadband": "0.5", "on_delay_s": 5.0, "priority": "high", "latch": True}
    settings = AlarmSettings.model_validate(written)
    path = tmp_path / "lineside.toml"
    unit = f'[[bus]]\nname = "{BUS}"\nport = "/dev/null"\n[[bus.unit]]\nid = 4\nname = "Nip"\n'
    path.write_text(unit + in_toml(settings))
    (read,) = load(path).alarm
    assert read == settings
