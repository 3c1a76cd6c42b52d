from __future__ import annotations

import pytest

from app.live.abnormal import Sight, Tally, Trouble, bus_trouble, unit_trouble, verdict
from app.live.motion import State
from app.live.suspicion import suspicion
from app.live.view import unit_json
from bus.contract import BusFigures, BusLink, ParameterValue, UnitLinkState
from tests.app.screens import AT_SPEED, HEALTHY, RUN, line, reading, voice


def trouble(
    link: UnitLinkState = "online", state: State = "at_speed", blocked: str = "", **changes: int
) -> tuple[str, str] | None:
    live = line()
    bus = live.buses["dry"]
    live.apply("dry", [reading(**changes)])
    found = unit_trouble(bus, Sight(bus.units[1], link, state, blocked), voice())
    return (found.level, found.code) if found else None


def test_a_unit_at_speed_in_remote_is_nothing() -> None:
    assert trouble() is None


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({"inputs": RUN}, ("urgent", "estop")),
        ({"state": "off_speed"}, ("high", "off_speed")),
        ({"link": "stale"}, ("low", "stale")),
        ({"link": "offline"}, ("high", "offline")),
        ({"blocked": "belt off"}, ("low", "blocked")),
        ({"outputs": AT_SPEED}, ("low", "mode")),
        ({"inputs": HEALTHY}, ("low", "run")),
    ],
)
def test_each_trouble_has_its_step(given: dict[str, str], found: tuple[str, str]) -> None:
    assert trouble(**given) == found  # type: ignore[arg-type]


def test_the_worst_is_said() -> None:
    assert trouble(state="off_speed", inputs=RUN, blocked="x") == ("urgent", "estop")


@pytest.mark.parametrize(
    ("said", "found"),
    [
        (ParameterValue(1, 17, 100.0, 1), None),
        (ParameterValue(1, 17, 100.0, None, available=False), None),
        (ParameterValue(1, 17, 100.0, 3), None),
        (BusFigures(1.0, 1.0, 1.0, 1.0, 1.0, answers_for_all=1), None),
        (
            BusFigures(1.0, 1.0, 1.0, 1.0, 1.0, answers_for_all=2),
            "perhaps unit 2 answers for it (each answer comes twice)",
        ),
    ],
)
def test_a_unit_in_whose_name_another_may_answer_is_not_well(
    said: ParameterValue | BusFigures, found: str | None
) -> None:
    live = line()
    bus = live.buses["dry"]
    live.apply("dry", [reading(), said])
    trouble = unit_trouble(bus, Sight(bus.units[1], "online", "at_speed"), voice())
    assert (trouble and (trouble.level, trouble.text)) == (found and ("high", found))
    assert unit_json(bus, bus.units[1], 100.0, lambda _bus, _unit: "")["suspect"] == found


def test_an_address_of_another_speaks_where_most_units_read_their_own() -> None:
    live = line(4)
    bus = live.buses["dry"]
    live.apply("dry", [reading(), ParameterValue(1, 17, 100.0, 3), ParameterValue(2, 17, 100.0, 3)])
    assert suspicion(bus, bus.units[1]) == ""
    live.apply("dry", [ParameterValue(3, 17, 100.0, 3)])
    assert suspicion(bus, bus.units[1]) == "", "units whose #17 says something else"
    live.apply("dry", [ParameterValue(2, 17, 100.0, 2)])
    assert suspicion(bus, bus.units[1]) == "perhaps unit 3 answers for it (#17)"
    assert suspicion(bus, bus.units[2]) == ""


def test_run_may_be_off_while_nothing_is_commanded() -> None:
    assert trouble(inputs=HEALTHY, commanded=0, actual=0, state="at_zero") is None


def test_one_poll_missed_is_no_trouble_yet() -> None:
    bus = line().buses["dry"]
    assert unit_trouble(bus, Sight(bus.units[1], "stale", "at_speed", overdue=False), voice()) is None


def test_a_bus_says_worker_or_port() -> None:
    live = line()
    bus = live.buses["dry"]
    assert bus_trouble(bus, voice(), 100.5) is None
    live.apply("dry", [BusLink(at=1, link="closed", cause="no such device")])
    found = bus_trouble(bus, voice(), 100.5)
    assert found is not None
    assert found.text == "the port is closed: no such device"
    bus.worker_connected = False
    found = bus_trouble(bus, voice(), 100.5)
    assert found is not None
    assert found.code == "worker"


def test_a_worker_that_stands_still_is_named_before_its_units() -> None:
    live = line()
    bus = live.buses["dry"]
    figures = BusFigures(at=100.0, scan_hz=4.8, scan_s=0.2, wire_utilisation=0.9, scan_s_with_one_more=0.3)
    live.apply("dry", [figures])
    assert bus_trouble(bus, voice(), 101.9) is None
    found = bus_trouble(bus, voice("de"), 102.1)
    assert found == Trouble("urgent", "der Busdienst sagt nichts", "worker", 100.0)
    live.apply("dry", [reading(at=102.0)])
    assert bus_trouble(bus, voice(), 102.1) is None, "a unit was heard through it"


@pytest.mark.parametrize(
    ("tally", "abnormal", "said"),
    [
        (Tally(), 0, "No unit is configured"),
        (Tally(units=8, heard=8, at_speed=8), 0, "All 8 units at speed"),
        (Tally(units=8, heard=8, at_zero=8), 0, "All 8 units at zero"),
        (Tally(units=8, heard=8, at_speed=5, ramping=3), 0, "3 of 8 ramping"),
        (Tally(units=8, heard=8, at_speed=5, at_zero=3), 0, "5 of 8 at speed, the others at zero"),
        (Tally(units=8), 1, "No unit answers"),
        (Tally(units=8, heard=8, at_speed=7), 1, "1 needs a look"),
        (Tally(units=8, heard=8, at_speed=6), 2, "2 need a look"),
    ],
)
def test_the_verdict_is_one_sentence(tally: Tally, abnormal: int, said: str) -> None:
    assert verdict(tally, abnormal, voice()) == said


def test_only_units_that_are_heard_are_in_a_state() -> None:
    bus = line().buses["dry"]
    tally = Tally()
    tally.count(Sight(bus.units[1], "stale", "at_speed"))
    assert (tally.units, tally.heard, tally.at_speed) == (1, 0, 0)
