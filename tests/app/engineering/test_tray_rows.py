"""What the review of a change tray shows of each kind of change."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from app.engineering.tray.contents import TrayRow, Unable, unable_units
from app.engineering.tray.own_tray import tray_rows
from app.errors import Problem
from app.line.commands.limits import NO_LIMITS
from app.line.commands.review import change_of
from app.line.commands.undo.changes import ValuePlace, Values, value_now
from app.line.live.bus_live import BusLive
from bus.contract import Action, ParameterValue, WriteParameter
from bus.messages import Message, in_english
from bus.settings import UnitLabels
from tests.app.played_commands import a_bus, responding

SPEED_1, SPEED_2 = ValuePlace("setpoint", 1), ValuePlace("setpoint", 2)
OUTPUT, ANALOG = ValuePlace("output", 1, 3), ValuePlace("analog", 2)
RAMP, MODE, BAUD = (ValuePlace("parameter", 1, number) for number in (6, 8, 18))
LOCAL = Message("obstacle_not_in_remote")
REFUSED = Message("no_such_parameter")
REACTS = "The equipment on this output reacts immediately."
UNREAD = "The unit acknowledges it; it cannot be read back."


@pytest.fixture
def bus() -> BusLive:
    live = a_bus()
    responding(live, run=True)
    bus = live.buses["dry-end"]
    object.__setattr__(bus.units[1].settings, "labels", UnitLabels(unit="m/min", output={3: "Fan"}))
    return bus


def rows(bus: BusLive, changes: dict[ValuePlace, int], *, local: int = 0) -> list[TrayRow]:
    """Unit ``local`` is in LOCAL; a write of #8 is refused."""

    def values_now(changes: Values) -> dict[ValuePlace, int | None]:
        return {place: value_now(place, bus, {2: 5}) for place in changes}

    def check(action: Action) -> None:
        if isinstance(action, WriteParameter) and action.number == 8:
            raise Problem(409, "invalid", REFUSED)

    page = SimpleNamespace(
        bus=bus,
        commands=SimpleNamespace(undo=SimpleNamespace(values_now=values_now)),
        change=lambda unit, raw: change_of(bus, bus.units[unit], raw, NO_LIMITS, time.time()),
        obstacle=lambda unit: LOCAL if unit == local else None,
        check=check,
    )
    return tray_rows(page, changes, {})  # type: ignore[arg-type]


def words(row: TrayRow) -> tuple[str, str, str, str, str, str]:
    texts = (row.what, row.old, row.new, row.measure, row.effect)
    return (row.name, *(in_english(text) for text in texts))


@pytest.mark.parametrize(
    ("place", "raw", "expected"),
    [
        (SPEED_1, 1500, ("Unwind", "Setpoint", "100.0", "150.0", "m/min", "ramp of about 0.2 s")),
        (SPEED_1, 1000, ("Unwind", "Setpoint", "100.0", "100.0", "m/min", "no change")),
        (SPEED_2, 1500, ("Nip", "Setpoint", "100.0", "150.0", "", "ramp of about 0.2 s")),
        (
            OUTPUT,
            1,
            ("Unwind", "Output 3 (Fan)", "off", "on", "", REACTS),
        ),
        (
            ValuePlace("output", 2, 3),
            0,
            ("Nip", "Output 3", "off", "off", "", REACTS),
        ),
        (
            ANALOG,
            7,
            ("Nip", "Analog output", "5", "7", "", UNREAD),
        ),
        (
            RAMP,
            75,
            (
                "Unwind",
                "Acceleration Ramp Rate (parameter 6)",
                "10.0",
                "7.5",
                "s",
                "Time to accelerate over the full speed range.",
            ),
        ),
    ],
)
def test_a_row_has_what_changes_from_which_value_to_which(
    bus: BusLive, place: ValuePlace, raw: int, expected: tuple[str, ...]
) -> None:
    [row] = rows(bus, {place: raw})
    assert words(row) == expected
    assert row.reviewed == f"{row.key}:{raw}:{row.was}"
    assert row.refusal is None


def test_an_unknown_value_is_empty(bus: BusLive) -> None:
    object.__setattr__(bus.units[2], "reading", None)
    unknown = {
        ValuePlace("output", 2, 1): 1,
        ValuePlace("analog", 1): 7,
        ValuePlace("parameter", 2, 12): 30,
    }
    for row in rows(bus, unknown):
        assert (row.was, row.old, row.was_text) == (None, "", "")
        assert row.reviewed.endswith(":")


def test_an_unknown_ramp_and_a_follower_have_their_effect(bus: BusLive) -> None:
    bus.apply([ParameterValue(unit=1, number=6, at=1.0, raw=None, available=False)])
    bus.apply([ParameterValue(unit=2, number=8, at=1.0, raw=1)])
    first, second = rows(bus, {SPEED_1: 1500, SPEED_2: 5000})
    assert in_english(first.effect) == "with the unit's own ramp; duration unknown"
    assert [in_english(text) for text in (second.what, second.new, second.effect)] == [
        "Ratio",
        "0.5000",
        "follows its master",
    ]


def test_setpoints_come_first_in_floor_order(bus: BusLive) -> None:
    changes = {RAMP: 75, SPEED_2: 10, OUTPUT: 1, SPEED_1: 10}
    assert [row.place for row in rows(bus, changes)] == [SPEED_1, SPEED_2, OUTPUT, RAMP]


def test_what_a_person_must_know_is_a_warning_or_a_danger(bus: BusLive) -> None:
    ramp, baud = rows(bus, {RAMP: 0, BAUD: 24})
    assert ([warning.code for warning in ramp.warnings], ramp.danger) == (["effect_no_ramp"], "")
    assert baud.danger


def test_a_unit_that_cannot_take_one_of_its_changes_is_named_with_the_first_reason(bus: BusLive) -> None:
    changes = {SPEED_1: 10, SPEED_2: 10, RAMP: 75, MODE: 1}
    assert unable_units(rows(bus, changes)) == {1: Unable(1, "Unwind", REFUSED)}
    both = unable_units(rows(bus, changes, local=2))
    assert both == {1: Unable(1, "Unwind", REFUSED), 2: Unable(2, "Nip", LOCAL)}
    assert unable_units(rows(bus, changes, local=1)) == {1: Unable(1, "Unwind", LOCAL)}
