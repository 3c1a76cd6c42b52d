"""Remarks of a review about its units: each fact, alone and together, and in the order of the tables."""

from __future__ import annotations

import pytest

from app.line.commands.review import Ramp, by_remark, obstacle_of, risks_of, risks_of_writing
from app.line.live.state.bus_live import LiveState
from bus.contract import BusLink, Update
from bus.messages import Message
from tests.app.screens import AT_SPEED, HEALTHY, RUN, line, reading

NOW = 100.0
KNOWN = Ramp(6, 100, 2.0)


def after(*updates: Update) -> LiveState:
    """The line, after these."""
    live = line()
    live.buses["dry"].apply(updates)
    return live


def remarks(live: LiveState, *, block: str = "", ramp: Ramp | None = KNOWN) -> tuple[str, list[str]]:
    """Return the codes of the remarks about unit 1."""
    bus = live.buses["dry"]
    reason = Message.of("block_by", reason=block, who="anna") if block else None
    obstacle = obstacle_of(bus, bus.units[1], NOW, block=reason)
    risks = risks_of(bus, bus.units[1], NOW, ramp)
    return "" if obstacle is None else obstacle.code, [risk.code for risk in risks]


@pytest.mark.parametrize(
    ("live", "block", "ramp", "expected"),
    [
        (after(), "", KNOWN, ("", [])),
        (after(), "", None, ("", [])),
        (after(), "belt off", KNOWN, ("obstacle_blocked", [])),
        (after(BusLink(at=NOW, link="closed")), "", KNOWN, ("obstacle_no_link", ["risk_stale"])),
        (after(reading(at=50.0)), "", KNOWN, ("obstacle_offline", [])),
        (after(reading(at=96.0)), "", KNOWN, ("", ["risk_stale"])),
        (after(reading(outputs=AT_SPEED)), "", KNOWN, ("obstacle_not_in_remote", [])),
        (after(reading(inputs=RUN)), "", KNOWN, ("", ["risk_estop_active"])),
        (after(reading(inputs=HEALTHY)), "", KNOWN, ("", ["risk_run_off"])),
        (after(), "", Ramp(7, 0, 0.0), ("", ["risk_no_ramp"])),
        (after(), "", Ramp(7, None, None), ("", ["risk_ramp_unknown"])),
        (after(), "", Ramp(7, 50, None), ("", ["risk_ramp_unknown"])),
        (
            after(reading(at=96.0, inputs=0, outputs=0)),
            "belt off",
            Ramp(7, 0, 0.0),
            ("obstacle_blocked", ["risk_stale", "risk_estop_active", "risk_run_off", "risk_no_ramp"]),
        ),
    ],
)
def test_each_fact_has_its_remark(
    live: LiveState, block: str, ramp: Ramp | None, expected: tuple[str, list[str]]
) -> None:
    assert remarks(live, block=block, ramp=ramp) == expected


def test_a_unit_that_never_responded_has_only_that_remark() -> None:
    live = line()
    live.buses["dry"].units[1].reading = None
    assert remarks(live) == ("obstacle_offline", [])


def test_the_dialect_decides_which_level_is_an_emergency_stop() -> None:
    live = after(reading(inputs=RUN))
    bus = live.buses["dry"]
    object.__setattr__(bus.settings, "estop_healthy", 0)
    assert remarks(live) == ("", [])


def test_the_numbers_are_params() -> None:
    bus = after(reading(at=96.4)).buses["dry"]
    obstacle = obstacle_of(bus, bus.units[1], NOW, block="{age}")
    assert obstacle == Message.of("obstacle_blocked", block="{age}")
    assert [risk.params for risk in risks_of(bus, bus.units[1], NOW, Ramp(7, 0, 0.0))] == [
        {"age": 4},
        {},
    ]


def test_one_remark_names_all_its_units() -> None:
    offline, local = Message("obstacle_offline"), Message("obstacle_not_in_remote")
    found = by_remark([("A", local), ("B", offline), ("C", local)])
    assert found == [(local, ["A", "C"]), (offline, ["B"])]


@pytest.mark.parametrize(
    ("number", "raw", "codes"),
    [
        (6, 0, ["risk_no_ramp"]),
        (7, 0, ["risk_no_ramp"]),
        (7, 1, []),
        (5, 0, []),
        (20, 5, ["risk_is_setpoint"]),
        (37, 5, ["risk_is_setpoint"]),
    ],
)
def test_what_a_write_to_a_parameter_may_surprise_with(number: int, raw: int, codes: list[str]) -> None:
    assert [risk.code for risk in risks_of_writing(number, raw)] == codes
