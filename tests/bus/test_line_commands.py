"""Every kind of command has a procedure with which a worker carries it out, and a claim on the wire."""

from __future__ import annotations

from collections.abc import Generator
from typing import get_args

import pytest

from bus.contract import (
    Action,
    ChangeBaud,
    ExecuteAll,
    ExecuteSpeed,
    ReadParameters,
    ReadTrace,
    ScanBus,
    SetLine,
    SetSpeed,
    WireAction,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.line.commands.catalogue import command_run_of
from bus.line.commands.procedure import EVERY_UNIT, NO_UNIT, Priority
from bus.line.line_loop import LineLoop
from bus.line.timing import RealClock
from bus.settings import BusSettings, UnitSettings

ONE = frozenset({1})
CLAIMS: list[tuple[WireAction, Priority, frozenset[int]]] = [
    (SetSpeed(1, 500), Priority.WRITE, ONE),
    (SetSpeed(1, 500, execute=False), Priority.WRITE, ONE),
    (ExecuteSpeed(1), Priority.WRITE, ONE),
    (WriteOutput(1, 2, True), Priority.WRITE, ONE),
    (WriteAnalogOutput(1, 350), Priority.WRITE, ONE),
    (WriteParameter(1, 6, 50), Priority.WRITE, ONE),
    (SetLine({1: 500, 2: 600}), Priority.WRITE, EVERY_UNIT),
    (ExecuteAll(), Priority.WRITE, EVERY_UNIT),
    (ChangeBaud(4800), Priority.WRITE, EVERY_UNIT),
    (ReadParameters(1), Priority.READ, NO_UNIT),
    (ReadParameters(1, urgent=False), Priority.SLOW, NO_UNIT),
    (ScanBus(), Priority.SLOW, NO_UNIT),
]


def test_every_action_but_the_trace_needs_the_wire_and_is_tried_here() -> None:
    assert set(get_args(Action)) - {ReadTrace} == set(get_args(WireAction))
    assert {type(action) for action, _, _ in CLAIMS} == set(get_args(WireAction))


@pytest.mark.parametrize(("action", "claim", "units"), CLAIMS, ids=lambda value: type(value).__name__)
async def test_what_writes_goes_first_and_claims_the_units_that_it_can_reach(
    action: WireAction, claim: Priority, units: frozenset[int]
) -> None:
    bus = BusSettings(name="a", port="/dev/null", unit=(UnitSettings(id=1, name="One"),))
    run = command_run_of(LineLoop(bus, RealClock(), lambda _: None), "a", action, 2.0)
    assert isinstance(run.begin(), Generator)
    assert (run.priority, run.units) == (claim, units)
    assert (run.priority is Priority.WRITE) == action.writes
