"""The cause of what is abnormal: the first broken rung of e-stop → run → mode → link → ramp, what else is
abnormal about a unit, and what is reported once for a bus."""

from __future__ import annotations

from typing import Any

import pytest

from app.line.conditions.unit import suspicion
from app.line.live.bus_live import LiveState, Onset
from app.line.live.diagnosis import (
    Cause,
    UnitView,
    broken_rung,
    connection_cause,
    no_response_cause,
    shown_cause,
    state_counts,
    unit_cause,
)
from app.line.live.fields import cause_texts, check_text
from bus.contract import BusFigures, BusLink, ParameterValue, Reading, UnitLink
from bus.messages import Message, term
from tests.app.screens import AT_SPEED, HEALTHY, REMOTE, RUN, line, reading, translator

LATER = 8520.0
"""02:22 on the first day."""
OFF_SPEED = {"outputs": REMOTE, "actual": 900}
STOPPED = {"outputs": REMOTE, "actual": 0}


def after(changes: dict[str, int], *, seconds: float = 10.0, link: str = "online") -> LiveState:
    """A unit at speed whose readings are changed from 02:22 on, for some seconds."""
    live = line()
    live.buses["dry"].apply([reading(1, at=LATER - 0.2)])
    steps = int(seconds / 0.2)
    live.buses["dry"].apply([reading(1, at=LATER + 0.2 * step, **changes) for step in range(steps + 1)])
    live.buses["dry"].apply([UnitLink(unit=1, at=LATER + seconds, link=link)])  # type: ignore[arg-type]
    return live


def cause_of(live: LiveState, now: float) -> Cause | None:
    bus = live.buses["dry"]
    return unit_cause(bus, bus.units[1], now)


def named(live: LiveState, now: float = LATER + 10, tag: str = "en") -> tuple[str, str]:
    """Level and first line."""
    found = cause_of(live, now)
    return (found.level, cause_texts(found, translator(tag), now).line) if found is not None else ("", "")


def test_a_unit_at_speed_in_remote_has_none() -> None:
    assert cause_of(after({}), LATER + 10) is None
    assert cause_of(after({"commanded": 0, "actual": 0, "inputs": HEALTHY}), LATER + 10) is None


@pytest.mark.parametrize(
    ("changes", "level", "text"),
    [
        (STOPPED | {"inputs": RUN}, "urgent", "Stopped: emergency stop active since 02:22"),
        (
            {"commanded": 0, "actual": 0, "inputs": RUN},
            "urgent",
            "Stopped: emergency stop active since 02:22",
        ),
        ({"inputs": RUN}, "urgent", "Turning: emergency stop active since 02:22"),
        (STOPPED | {"inputs": HEALTHY}, "high", "Stopped: run input off since 02:22"),
        ({"inputs": HEALTHY}, "urgent", "Turning without run since 02:22"),
        ({"inputs": HEALTHY, "commanded": 0, "actual": 30}, "urgent", "Turning without run since 02:22"),
        ({"outputs": AT_SPEED}, "low", "Not in REMOTE since 02:22"),
        ({"outputs": 0, "actual": 900}, "high", "Off speed: not in REMOTE since 02:22"),
        (OFF_SPEED, "high", "Off speed since 02:22"),
        (STOPPED, "high", "Stopped with run input on since 02:22"),
    ],
)
def test_the_first_broken_rung_is_named_with_its_time(changes: dict[str, int], level: str, text: str) -> None:
    assert named(after(changes)) == (level, text)


@pytest.mark.parametrize(
    ("changes", "code", "rung"),
    [
        ({"outputs": 0, "actual": 0, "inputs": 0}, "estop_active", "e-stop urgent"),
        ({"outputs": 0, "actual": 0, "inputs": HEALTHY}, "run_off", "run high"),
        ({"outputs": 0, "actual": 0}, "not_in_remote", "mode high"),
        ({"outputs": REMOTE, "actual": 0}, "not_at_speed", "ramp high"),
    ],
)
def test_a_rung_hides_those_that_need_it(changes: dict[str, int], code: str, rung: str) -> None:
    found = cause_of(after(changes), LATER + 10)
    assert found is not None
    assert (found.code, broken_rung(found)) == (code, rung)


def test_while_it_slows_down_it_is_not_shown_as_stopped() -> None:
    live = line()
    live.buses["dry"].apply([reading(1, at=LATER - 0.2)])
    slowing = [reading(1, at=LATER + 0.2 * n, inputs=HEALTHY, actual=1200 - 50 * n) for n in range(10)]
    live.buses["dry"].apply(slowing)
    assert named(live, LATER + 2) == ("high", "Still turning: run input off since 02:22")


def test_slowing_down_to_a_commanded_zero_without_run_is_not_abnormal() -> None:
    live = after({"inputs": HEALTHY, "commanded": 0, "actual": 300}, seconds=1.0)
    assert named(live, LATER + 1) == ("", "Still turning: run input off since 02:22")


def test_turning_is_dated_from_when_it_began_and_not_from_when_run_went_off() -> None:
    live = after(STOPPED | {"inputs": HEALTHY})
    live.buses["dry"].apply(
        [reading(1, at=LATER + 10 + 0.2 * n, inputs=HEALTHY, actual=40) for n in range(620)]
    )
    assert named(live, LATER + 134)[1] == "Turning without run since 02:22"
    found = cause_of(live, LATER + 134)
    assert found is not None
    assert found.onset == Onset(LATER + 10)


def test_the_link_comes_after_what_was_last_read_and_before_the_ramp() -> None:
    late = after(OFF_SPEED, link="stale")
    assert named(late, LATER + 13) == ("low", "Response overdue since 02:22")
    assert named(after(OFF_SPEED, link="stale"), LATER + 11)[1] == "Off speed since 02:22", "one poll missed"
    assert named(after(STOPPED | {"inputs": HEALTHY}, link="stale"), LATER + 13)[1].startswith("Stopped: run")


def test_of_a_unit_that_is_offline_nothing_else_is_claimed() -> None:
    live = after(STOPPED | {"inputs": RUN}, link="offline")
    assert named(live, LATER + 700) == ("high", "No response since 02:22")


def test_a_worker_that_does_not_respond_is_the_cause_of_its_units() -> None:
    live = after({})
    live.buses["dry"].apply(
        [BusFigures(at=LATER + 10, scan_hz=5, scan_s=0.2, wire_utilisation=0.9, scan_s_with_one_more=0.3)]
    )
    assert named(live, LATER + 70)[1] == "Bus worker does not respond since 02:22"
    live.buses["dry"].lose_worker(LATER + 80)
    assert named(live, LATER + 90)[1] == "Bus worker does not respond since 02:23"


def test_a_unit_never_read_and_a_unit_lost_before_the_start_with_its_time() -> None:
    live = line()
    bus = live.buses["dry"]
    bus.units[1].reading = None
    assert named(live, 105.0) == ("low", "No response yet")
    assert named(live, 200.0) == ("high", "No response since at least 00:01"), "as its alarm"
    bus.units[1].last_response = 60.0
    assert named(live, 105.0) == ("low", "No response yet"), "it has its time to respond"
    assert named(live, 111.0) == ("high", "No response since 00:01")


RAMPING: list[tuple[dict[int, int | None], str]] = [
    ({}, "Ramping to 120.0, about 2\u00a0s left"),
    ({6: 5000}, "Ramping to 120.0, about 75\u00a0s left"),
    ({6: 9999, 2: 400}, "Ramping to 120.0, about 12\u00a0min left"),
    ({6: None}, "Ramping to 120.0"),
    ({2: None}, "Ramping to 120.0"),
    ({8: 1}, "Ramping to 120.0"),
]


@pytest.mark.parametrize(("parameters", "text"), RAMPING)
def test_a_ramp_shows_its_target_and_known_duration(parameters: dict[int, int | None], text: str) -> None:
    live = after({"outputs": REMOTE, "actual": 900}, seconds=1.0)
    values = [ParameterValue(1, n, LATER, raw, available=raw is not None) for n, raw in parameters.items()]
    live.buses["dry"].apply(values)
    assert named(live, LATER + 1) == ("", text)


def test_a_ramp_down_takes_the_deceleration() -> None:
    live = line()
    live.buses["dry"].apply([reading(1, at=LATER, commanded=0, actual=1000, outputs=REMOTE)])
    assert named(live, LATER)[1] == "Ramping to 0.0, about 10\u00a0s left"


def test_what_was_there_at_the_start_is_first_seen_then() -> None:
    live = line()
    live.buses["dry"].units[1] = LiveState([live.buses["dry"].settings], 0.0).buses["dry"].units[1]
    live.buses["dry"].apply([reading(1, at=LATER, **(STOPPED | {"inputs": HEALTHY}))])
    assert named(live, LATER + 1)[1] == "Stopped: run input off since at least 02:22"
    assert named(live, LATER + 1, tag="de")[1] == "Steht: Eingang Lauf aus mindestens seit 02:22"


def test_the_text_of_the_strip_has_no_time() -> None:
    found = cause_of(after(STOPPED | {"inputs": HEALTHY}), LATER + 10)
    assert found is not None
    assert cause_texts(found, translator(), LATER).text == "Stopped: run input off"
    assert check_text(found, translator()) == "Check the run contact at the drive"
    assert check_text(None, translator()) == ""


def test_units_that_read_ratios_are_not_shown_as_stopped_or_turning() -> None:
    settings = line().buses["dry"].settings.model_copy(update={"follower_speed": "ratio"})
    live = LiveState([settings], 0.0)
    live.buses["dry"].worker_lost = None
    values: list[Any] = [BusLink(at=LATER, link="open"), ParameterValue(1, 8, LATER, 1)]
    ratio: list[Reading] = [reading(1, at=LATER + n, inputs=HEALTHY, outputs=REMOTE) for n in range(10)]
    live.buses["dry"].apply([*values, UnitLink(unit=1, at=LATER, link="online"), *ratio])
    assert named(live)[1] == "Run input off since at least 02:22"


NOW = 100.0


def shown(
    blocked: str = "", drifted: str = "", link: str = "online", **changes: int
) -> tuple[str, str] | None:
    """Level and code of what the first line of a unit names."""
    live = line()
    live.buses["dry"].apply([UnitLink(unit=1, at=NOW, link=link), reading(**changes)])  # type: ignore[arg-type]
    bus = live.buses["dry"]
    found = shown_cause(
        bus,
        bus.units[1],
        unit_cause(bus, bus.units[1], NOW),
        NOW,
        blocked=Message.of("block_by", reason=blocked, who="anna") if blocked else None,
        drifted=drifted,
    )
    return (found.level, found.code) if found else None


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({"blocked": "belt off"}, ("low", "blocked")),
        ({"drifted": "2 values"}, ("low", "drift")),
        ({"blocked": "belt off", "drifted": "2 values"}, ("low", "blocked")),
        ({"blocked": "belt off", "inputs": RUN}, ("urgent", "estop_active")),
        ({"blocked": "belt off", "outputs": AT_SPEED}, ("low", "not_in_remote")),
        ({"blocked": "belt off", "link": "offline"}, ("high", "unit_offline")),
        ({"drifted": "2 values", "commanded": 0, "actual": 300, "inputs": HEALTHY}, ("low", "drift")),
        ({"drifted": "2 values", "outputs": 0x40, "actual": 900}, ("low", "drift")),
    ],
)
def test_a_broken_rung_comes_before_what_else_is_abnormal(
    given: dict[str, str], found: tuple[str, str]
) -> None:
    assert shown(**given) == found  # type: ignore[arg-type]


def test_an_address_of_another_speaks_where_most_units_read_their_own() -> None:
    live = line(4)
    bus = live.buses["dry"]
    live.buses["dry"].apply([reading(), ParameterValue(1, 17, NOW, 3), ParameterValue(2, 17, NOW, 3)])
    assert suspicion(bus, bus.units[1]) is None
    live.buses["dry"].apply([ParameterValue(3, 17, NOW, 3)])
    assert suspicion(bus, bus.units[1]) is None, "other units have another #17"
    live.buses["dry"].apply([ParameterValue(2, 17, NOW, 2)])
    assert str(suspicion(bus, bus.units[1])) == "unit 3 may respond in its place"
    assert suspicion(bus, bus.units[2]) is None


def test_a_bus_names_worker_or_port_and_since_when() -> None:
    live = line()
    bus = live.buses["dry"]
    assert connection_cause(bus, 100.5) is None
    live.buses["dry"].apply([BusLink(at=101.0, link="closed", cause=term("no such device"))])
    live.buses["dry"].apply([BusLink(at=105.0, link="closed", cause=term("permission denied"))])
    denied = {"why": term("permission denied")}
    assert connection_cause(bus, 110.0) == Cause("port_lost", "urgent", Onset(101.0), denied)
    live.buses["dry"].lose_worker(120.0)
    assert connection_cause(bus, 130.0) == Cause("worker_lost", "urgent", Onset(120.0))


def test_a_worker_that_stands_still_is_named_before_its_units() -> None:
    live = line()
    bus = live.buses["dry"]
    figures = BusFigures(at=NOW, scan_hz=4.8, scan_s=0.2, wire_utilisation=0.9, scan_s_with_one_more=0.3)
    live.buses["dry"].apply([figures])
    assert connection_cause(bus, 101.9) is None
    assert connection_cause(bus, 102.1) == Cause("worker_silent", "urgent", Onset(NOW))
    live.buses["dry"].apply([reading(at=102.0)])
    assert connection_cause(bus, 102.1) is None, "a unit responded through it"


def test_a_bus_on_which_no_unit_responds_is_one_cause() -> None:
    bus = line(units=3).buses["dry"]
    bus.apply([reading(1, at=NOW - 50), UnitLink(unit=1, at=NOW, link="offline")])
    assert no_response_cause(bus, NOW) is None
    bus.apply([UnitLink(unit=2, at=NOW, link="offline")])
    assert no_response_cause(bus, NOW) is None, "the third may be well"
    bus.units[3].reading = None
    assert no_response_cause(bus, NOW) == Cause("no_unit_responds", "urgent", Onset(NOW))
    bus.apply([UnitLink(unit=3, at=NOW, link="offline")])
    assert no_response_cause(bus, NOW) == Cause("no_unit_responds", "urgent", Onset(NOW))


def test_units_that_have_their_time_to_respond_first_are_one_cause() -> None:
    bus = line(units=2).buses["dry"]
    for unit in bus.units.values():
        unit.reading = None
    assert no_response_cause(bus, NOW + 1) == Cause("no_unit_yet", "low")
    late = no_response_cause(bus, NOW + 100)
    assert late == Cause("no_unit_responds", "urgent", Onset(NOW, exact=False))


def test_the_only_unit_of_a_bus_is_named_itself() -> None:
    bus = line(units=1).buses["dry"]
    bus.apply([UnitLink(unit=1, at=NOW, link="offline")])
    assert no_response_cause(bus, NOW) is None


def test_only_units_that_respond_are_in_a_state() -> None:
    bus = line().buses["dry"]
    counts = state_counts(UnitView(bus.units[1], link, None) for link in ("online", "stale"))  # type: ignore[arg-type]
    assert (counts["online"], counts["at_speed"]) == (1, 1)
