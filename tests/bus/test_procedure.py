"""Every kind of command has a procedure and a claim on the wire, and what happens to it is reported."""

from __future__ import annotations

from collections.abc import Generator
from typing import Never, get_args

import pytest

from bus.contract import (
    Action,
    ChangeBaud,
    ExecuteAll,
    ExecuteSpeed,
    FoundUnit,
    Progress,
    ReadParameters,
    ReadTrace,
    ScanBus,
    SetLine,
    SetSpeed,
    Update,
    WireAction,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.line.commands.catalogue import command_run_of
from bus.line.commands.procedure import (
    EVERY_UNIT,
    NO_UNIT,
    CommandContext,
    CommandRun,
    Priority,
    ProcedureResult,
    ReportProgress,
)
from bus.line.line_loop import LineLoop
from bus.line.timing import RealClock
from bus.line.trace import TracedFrame
from bus.messages import Message
from bus.settings import BusSettings, Dialect, UnitSettings

PLAIN = Dialect()


def never(*_: object) -> Never:
    raise AssertionError


def ended(result: ProcedureResult, frames: list[TracedFrame]) -> CommandRun:
    run = CommandRun("c1", Priority.READ, NO_UNIT, 2.0, CommandContext(PLAIN), never, never, frames)
    run.end(result)
    return run


async def test_progress() -> None:
    updates: list[Update] = []
    clock = RealClock()
    clock.epoch = lambda _now: 12.5
    line = LineLoop(BusSettings(name="a", port="/dev/null"), clock, updates.extend)
    line.apply("c1", ReportProgress("proving", 3, 1, 8))
    line.cancel("another")
    assert updates == [Progress("c1", 12.5, "proving", 3, 1, 8)]


def test_a_result_has_the_id_the_time_and_the_frames_of_its_command() -> None:
    frames = [TracedFrame(12.0, "out", bytes.fromhex("1002018310037c"))]
    update = ended(ProcedureResult("acknowledged"), frames).report(12.5, PLAIN)
    assert (update.id, update.at, update.outcome) == ("c1", 12.5, "acknowledged")
    assert [frame.data for frame in update.frames] == [frames[0].data]


def test_a_result_of_a_scan_has_the_units_that_it_found() -> None:
    remark = Message("found_two_units")
    found = FoundUnit(5, 9600, "digimax", [1, 2], [remark])
    update = ended(ProcedureResult("verified", found=[found]), []).report(12.5, PLAIN)
    assert update.found == [found]


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
