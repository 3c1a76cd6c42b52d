"""What happens to a command, as the app receives it."""

from __future__ import annotations

from typing import Never

from bus.contract import FoundUnit, Progress, Update
from bus.line.commands.procedure import (
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
from bus.settings import BusSettings, Dialect

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
