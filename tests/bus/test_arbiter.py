"""Whose request is next, and every kind of command with its procedure and its claim on the wire."""

from __future__ import annotations

from collections.abc import Generator, Iterator
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
from bus.line.arbiter import Arbiter, NextRequest
from bus.line.commands.catalogue import command_run_of
from bus.line.commands.procedure import (
    EVERY_UNIT,
    NO_UNIT,
    CommandContext,
    CommandRun,
    Priority,
    Procedure,
    ProcedureResult,
    ReportProgress,
)
from bus.line.line_loop import LineLoop
from bus.line.poll_schedule import PollSchedule
from bus.line.send import ExchangeResult, Send
from bus.line.timing import RealClock
from bus.line.trace import TracedFrame
from bus.messages import Message
from bus.settings import BusSettings, Dialect, UnitSettings
from bus.wire.commands import Ack, ReadStatusRequest, Reply, Request, SetAndExecuteSpeedRequest, StatusReply
from bus.wire.exchange import PendingResponses

PLAIN = Dialect()
POLL_S = 0.026


class Line:
    """Turns of a line whose units all respond; time advances by a poll for each."""

    def __init__(self, units: int, least_scan_s: float = 0.0) -> None:
        self.time = 100.0
        self.schedule = PollSchedule(range(1, units + 1), POLL_S, least_scan_s=least_scan_s)
        self.turns = Arbiter(
            self.schedule, lambda unit: PendingResponses(unit, PLAIN), lambda _request: POLL_S
        )
        self.schedule.next(self.time)
        for _ in range(units - 1):
            self.schedule.next(self.time)
        for unit in range(1, units + 1):
            self.schedule.responded(unit, self.time)
        while self.schedule.parameters.next_needed():
            """All that is needed is known."""

    def poll(self) -> NextRequest:
        """The next turn; a poll, when nothing else is due."""
        turn = self.next()
        while not isinstance(turn.request, ReadStatusRequest):
            self.settle(turn, None)
            turn = self.next()
        return turn

    def next(self) -> NextRequest:
        """The next turn, a poll's time later."""
        self.time += POLL_S
        turn = self.turns.next_request(self.time)
        assert turn is not None
        return turn

    def settle(self, turn: NextRequest, reply: Reply | None) -> bool:
        """Its exchange is over."""
        result = ExchangeResult(turn.request, reply, self.time - POLL_S, self.time, self.time)
        return self.turns.settle(turn, result)


def _response(request: Request) -> StatusReply:
    return StatusReply(request.unit, 1, 1, 0, 0, 0)


def _write(unit: int) -> CommandRun:
    def procedure() -> Procedure:
        yield Send(SetAndExecuteSpeedRequest(unit, 500))
        return ProcedureResult("acknowledged")

    return CommandRun(
        "c1", Priority.WRITE, frozenset({unit}), 200.0, CommandContext(PLAIN), procedure, lambda _note: None
    )


def _foreseen(line: Line, times: int) -> Iterator[NextRequest]:
    turn = line.poll()
    for _ in range(times):
        following = line.turns.foresee(turn, line.time)
        line.settle(turn, _response(turn.request))
        if following is None:
            turn = line.poll()
            continue
        line.time += POLL_S
        line.turns.follow(line.time)
        yield following
        turn = following if isinstance(following.request, ReadStatusRequest) else line.poll()


def test_what_was_foreseen_has_its_turn_and_every_unit_keeps_its_own() -> None:
    line = Line(4)
    followed = list(_foreseen(line, 200))
    assert len(followed) > 150
    polled = [turn.request.unit for turn in followed if isinstance(turn.request, ReadStatusRequest)]
    counts = [polled.count(unit) for unit in range(1, 5)]
    assert max(counts) - min(counts) <= 4


def test_a_command_goes_first_and_what_was_foreseen_after_it() -> None:
    line = Line(3)
    turn = line.poll()
    following = line.turns.foresee(turn, line.time)
    assert following is not None
    run = _write(turn.request.unit)
    line.turns.commands.add(run)
    line.settle(turn, _response(turn.request))
    write = line.next()
    assert write == (SetAndExecuteSpeedRequest(turn.request.unit, 500), run)
    assert line.turns.foresee(write, line.time) is None
    line.settle(write, Ack(turn.request.unit))
    line.turns.commands.take_finished()
    assert line.next() == following


def test_a_poll_without_a_response_is_tried_again_before_what_was_foreseen() -> None:
    line = Line(3)
    turn = line.poll()
    following = line.turns.foresee(turn, line.time)
    assert following is not None
    assert line.settle(turn, None), "it is tried again"
    assert line.next() == turn
    line.settle(turn, _response(turn.request))
    assert line.next() == following


def test_nothing_is_foreseen_while_a_write_is_announced() -> None:
    line = Line(3)
    turn = line.poll()
    line.turns.reserve(line.time)
    assert line.turns.foresee(turn, line.time) is None


def test_of_a_line_with_one_unit_nothing_is_foreseen() -> None:
    """What the unit sends twice must not be taken for the next response, so the response is settled first."""
    line = Line(1)
    for _ in range(20):
        turn = line.poll()
        assert line.turns.foresee(turn, line.time) is None
        line.settle(turn, _response(turn.request))


def test_a_limit_of_the_scan_holds_no_command_up() -> None:
    line = Line(2, least_scan_s=60.0)
    while line.schedule.parameters.next_background():
        """All is read."""
    turn = line.poll()
    line.settle(turn, _response(turn.request))
    line.time += 1.0
    assert line.turns.foresee(turn, line.time) is None
    line.turns.commands.add(_write(1))
    turn = line.next()
    assert turn.run is not None
    line.settle(turn, Ack(1))
    assert line.turns.next_request(line.time + 20.0) is None, "half a minute apart"
    assert min(at for at in line.turns.moments() if at > line.time + 20.0) < 131.0


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
