"""What happens to a command, as the app receives it."""

from __future__ import annotations

from bus.contract import FoundUnit, Progress, Result
from bus.line.commands.procedure import ProcedureResult, ReportProgress
from bus.line.events import CommandFinished, CommandProgressed
from bus.line.scan.found import Found
from bus.line.statistics.trace import TracedFrame
from bus.messages import Message
from bus.settings import Dialect
from bus.worker.command_messages import update_of

PLAIN = Dialect()


def test_progress() -> None:
    event = CommandProgressed("c1", 12.5, ReportProgress("proving", 3, 1, 8))
    assert update_of(event, PLAIN) == Progress("c1", 12.5, "proving", 3, 1, 8)


def test_a_result_has_the_id_the_time_and_the_frames_of_its_command() -> None:
    frames = [TracedFrame(12.0, "out", bytes.fromhex("1002018310037c"))]
    update = update_of(CommandFinished("c1", 12.5, ProcedureResult("acknowledged"), frames), PLAIN)
    assert isinstance(update, Result)
    assert (update.id, update.at, update.outcome) == ("c1", 12.5, "acknowledged")
    assert [frame.data for frame in update.frames] == [frames[0].data]


def test_a_result_of_a_scan_has_the_units_that_it_found() -> None:
    remark = Message("found_two_units")
    found = Found(5, 9600, "digimax", (1, 2), (remark,))
    update = update_of(CommandFinished("c1", 12.5, ProcedureResult("verified", found=(found,)), []), PLAIN)
    assert isinstance(update, Result)
    assert update.found == [FoundUnit(5, 9600, "digimax", [1, 2], [remark])]
