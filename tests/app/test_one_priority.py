"""A condition has one priority: on the tile, in the verdict and in the list of alarms."""

from __future__ import annotations

from itertools import product
from typing import get_args

import pytest

from app.alarms.catalogue import built_in
from app.alarms.conditions import BY_READING
from app.built_in_settings import BuiltIn
from app.conditions.catalogue import CONDITIONS, UnalarmedCondition
from app.conditions.priority import PRIORITIES, AlarmPriority
from app.live.diagnosis.abnormal import shown_cause
from app.live.diagnosis.cause import Cause, abnormal, bus_cause
from app.live.screen.cause_text import CAUSE_TEXTS
from app.live.state.bus_live import LiveState
from bus.contract import BusLink, ParameterValue, UnitLink
from bus.messages import Message
from tests.app.screens import AT_SPEED, HEALTHY, REMOTE, RUN, line, reading, screen

NOW = 100.0
DRAWN = {"urgent", "high", "low"}
"""What a tile, the strip and the verdict have a shape for."""


def of_alarm(code: BuiltIn) -> AlarmPriority:
    return built_in(code, "dry").priority


def after(seconds: float = 10.0, **changes: int) -> LiveState:
    """A unit whose readings are like this for some time."""
    live = line()
    steps = [NOW + 0.2 * step for step in range(int(seconds / 0.2) + 1)]
    live.buses["dry"].apply([reading(1, at=at, **changes) for at in steps])
    live.buses["dry"].apply([reading(2, at=NOW + seconds)])
    return live


def cause_of(live: LiveState, now: float = NOW + 10, drifted: str = "", blocked: str = "") -> Cause | None:
    bus = live.buses["dry"]
    why = Message.of("block_by", reason=blocked, who="anna") if blocked else None
    return shown_cause(bus, bus.units[1], now, blocked=why, drifted=drifted)


@pytest.mark.parametrize(
    ("inputs", "outputs", "actual", "commanded"),
    list(
        product(
            (RUN | HEALTHY, HEALTHY, RUN), (AT_SPEED | REMOTE, REMOTE, AT_SPEED, 0), (1200, 900, 0), (1200, 0)
        )
    ),
)
def test_the_tile_has_the_priority_of_the_alarms_of_the_condition_that_it_names(
    inputs: int, outputs: int, actual: int, commanded: int
) -> None:
    live = after(inputs=inputs, outputs=outputs, actual=actual, commanded=commanded)
    bus, cause = live.buses["dry"], cause_of(live)
    held = [code for code, holds in BY_READING.items() if holds(bus, bus.units[1])]
    if cause is None or cause.code not in held:
        # A run input that is off comes before the mode, and has no alarm.
        assert held == [] or (cause is not None and cause.code == "run_off")
        return
    assert cause.level == min(map(of_alarm, held), key=PRIORITIES.index)
    live_screen = screen(live)
    live_screen.refresh(NOW + 10)
    assert live_screen.shown["dry/1"]["level"] == live_screen.entries[0].level == cause.level


def test_every_condition_of_a_reading_is_named_by_some_tile() -> None:
    named = {
        cause.code
        for inputs, outputs, actual in product((RUN | HEALTHY, HEALTHY, RUN), (REMOTE, 0), (900, 0))
        if (cause := cause_of(after(inputs=inputs, outputs=outputs, actual=actual))) is not None
    }
    assert set(BY_READING) <= named


def test_a_lost_unit_bus_or_worker_has_the_priority_of_its_alarm() -> None:
    live = line()
    bus = live.buses["dry"]
    bus.apply([UnitLink(unit=1, at=NOW, link="offline")])
    assert (found := cause_of(live, NOW)) is not None
    assert (found.code, found.level) == ("unit_offline", of_alarm("unit_offline"))
    bus.apply([BusLink(at=NOW, link="closed")])
    assert (found := bus_cause(bus, NOW)) is not None
    assert (found.code, found.level) == ("port_lost", of_alarm("port_lost"))
    bus.lose_worker(NOW)
    assert (found := bus_cause(bus, NOW)) is not None
    assert (found.code, found.level) == ("worker_lost", of_alarm("worker_lost"))


def test_a_condition_of_parameters_has_the_priority_of_its_alarm() -> None:
    live = line()
    assert (found := cause_of(live, NOW, drifted="#6")) is not None
    assert (found.code, found.level) == ("drift", of_alarm("parameter_drift"))
    live = line(units=3)
    read = {1: 9, 2: 2, 3: 3}
    live.buses["dry"].apply([ParameterValue(unit=n, number=17, at=NOW, raw=own) for n, own in read.items()])
    assert (found := cause_of(live, NOW)) is not None
    assert (found.code, found.level) == ("address_suspect", of_alarm("duplicate_address"))


@pytest.mark.parametrize(
    ("code", "condition"),
    [
        *((code, code) for code in get_args(UnalarmedCondition)),
        ("no_unit_responds", "no_unit_responds"),
        ("worker_silent", "worker_lost"),
        ("address_suspect", "duplicate_address"),
        ("drift", "parameter_drift"),
    ],
)
def test_a_cause_reads_the_row_of_its_condition(code: str, condition: BuiltIn) -> None:
    assert abnormal(code).level == CONDITIONS[condition].priority


@pytest.mark.parametrize("code", CAUSE_TEXTS)
def test_every_cause_has_a_condition_and_a_shape(code: str) -> None:
    assert abnormal(code).level in DRAWN


def test_all_units_lost_are_one_cause_with_the_priority_of_its_alarm() -> None:
    live = line()
    bus = live.buses["dry"]
    bus.apply([UnitLink(unit=number, at=NOW, link="offline") for number in bus.units])
    (verdict,) = screen(live).entries
    assert (verdict.text, verdict.level) == ("No unit responds", of_alarm("no_unit_responds"))
