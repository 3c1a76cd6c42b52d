"""Whose request is next, and what is known of it before the answer under way is there."""

from __future__ import annotations

from collections.abc import Iterator

from bus.line.commands.command_run import CommandRun, Priority
from bus.line.commands.procedure import CommandContext, Procedure
from bus.line.commands.result import ProcedureResult
from bus.line.exchange.send import Send
from bus.line.exchange.send_attempts import ExchangeResult
from bus.line.schedule.arbiter import Arbiter
from bus.line.schedule.poll_schedule import PollSchedule
from bus.settings import Dialect
from bus.wire.commands import Ack, ReadStatusRequest, Reply, Request, SetAndExecuteSpeedRequest, StatusReply
from bus.wire.fence import PendingResponses

PLAIN = Dialect()
POLL_S = 0.026


class Line:
    """Turns of a line whose units all answer; time goes on by a poll for each."""

    def __init__(self, units: int) -> None:
        self.time = 100.0
        self.schedule = PollSchedule(range(1, units + 1), POLL_S)
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

    def poll(self) -> Request:
        """The next request; a poll, when nothing else is due."""
        self.time += POLL_S
        request = self.turns.next_request(self.time)
        while not isinstance(request, ReadStatusRequest):
            assert request is not None
            self.settle(request, None)
            self.time += POLL_S
            request = self.turns.next_request(self.time)
        return request

    def settle(self, request: Request, reply: Reply | None) -> bool:
        """It was answered, or not."""
        return self.turns.settle(ExchangeResult(request, reply, self.time), self.time - POLL_S, self.time)


def _answer(request: Request) -> StatusReply:
    return StatusReply(request.unit, 1, 1, 0, 0, 0)


def _write(unit: int) -> CommandRun:
    def procedure() -> Procedure:
        yield Send(SetAndExecuteSpeedRequest(unit, 500))
        return ProcedureResult("acknowledged")

    return CommandRun(
        "c1", Priority.WRITE, frozenset({unit}), 200.0, CommandContext(PLAIN), procedure, lambda _note: None
    )


def _foreseen(line: Line, times: int) -> Iterator[tuple[Request, Request]]:
    request = line.poll()
    for _ in range(times):
        following = line.turns.foresee(request, line.time)
        if following is None:
            line.settle(request, _answer(request))
            request = line.poll()
            continue
        line.time += POLL_S
        line.settle(request, _answer(request))
        assert line.turns.followed(line.time) == following
        yield request, following
        request = following if isinstance(following, ReadStatusRequest) else line.poll()


def test_what_was_foreseen_has_its_turn_and_every_unit_keeps_its_own() -> None:
    line = Line(4)
    pairs = list(_foreseen(line, 200))
    assert len(pairs) > 150
    polled = [following.unit for _, following in pairs if isinstance(following, ReadStatusRequest)]
    counts = [polled.count(unit) for unit in range(1, 5)]
    assert max(counts) - min(counts) <= 4


def test_an_errand_goes_first_and_what_was_foreseen_after_it() -> None:
    line = Line(3)
    request = line.poll()
    following = line.turns.foresee(request, line.time)
    assert following is not None
    line.turns.commands.add(_write(request.unit))
    line.settle(request, _answer(request))
    line.time += POLL_S
    assert line.turns.next_request(line.time) == SetAndExecuteSpeedRequest(request.unit, 500)
    assert line.turns.foresee(SetAndExecuteSpeedRequest(request.unit, 500), line.time) is None
    line.turns.commands.cancel("c1")
    line.turns.owner = None
    for run in line.turns.commands:
        run.end(ProcedureResult("not_sent"))
    line.turns.commands.take_finished()
    assert line.turns.next_request(line.time + POLL_S) == following


def test_a_poll_without_an_answer_is_tried_again_before_what_was_foreseen() -> None:
    line = Line(3)
    request = line.poll()
    following = line.turns.foresee(request, line.time)
    assert following is not None
    assert line.settle(request, None), "it is tried again"
    line.time += POLL_S
    assert line.turns.next_request(line.time) == request
    line.settle(request, _answer(request))
    line.time += POLL_S
    assert line.turns.next_request(line.time) == following


def test_a_write_without_an_answer_is_tried_again_too() -> None:
    line = Line(2)
    polled = line.poll()
    line.turns.commands.add(_write(2))
    line.settle(polled, _answer(polled))
    write = SetAndExecuteSpeedRequest(2, 500)
    assert line.turns.next_request(line.time) == write
    assert line.settle(write, None), "it is tried again"
    assert line.turns.next_request(line.time) == write
    assert not line.settle(write, Ack(2)), "it was answered"


def test_of_a_line_with_one_unit_nothing_is_foreseen() -> None:
    """What the unit answers twice must not be taken for the next answer, so the answer is pondered first."""
    line = Line(1)
    for _ in range(20):
        request = line.poll()
        assert line.turns.foresee(request, line.time) is None
        line.settle(request, _answer(request))
