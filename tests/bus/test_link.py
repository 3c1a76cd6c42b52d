"""One exchange at a time on a fake port and clock: windows, deadlines, leftovers, and who awaits its end."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from bus.contract import MAX_FRAME, MAX_MEANINGS
from bus.errors import WireError
from bus.line.link import SECRET_LINGERS_S, Completion, CurrentExchange, Link, run_at_once
from bus.line.port import PartlySent
from bus.line.roster import Roster
from bus.line.send import ExchangeResult
from bus.line.timing import MARGIN_S, PortPace
from bus.line.trace import HIDDEN, Interpreter, Trace, TracedFrame
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.commands import (
    Ack,
    ExecuteSpeedRequest,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StatusReply,
    WriteParameterRequest,
    encode_reply,
)
from tests.bus.played_clock import PlayedClock

PLAIN = Dialect()
BYTE_S = 10 / 9600
TURNAROUND_S = 0.050
GONE = Message("adapter_gone")
STATUS = StatusReply(1, 500, 498, 77, 0xC0, 0x03)


class Wires(PlayedClock):
    """Clock, alarms and port in one; time goes on only by ``pass_time``."""

    def __init__(self) -> None:
        super().__init__()
        self.written: list[bytes] = []
        self.dropped = 0
        self.listens = True
        self.gathered = b""
        self.exchanges: list[Completion[CurrentExchange]] = []
        self.roster = Roster([1, 2], 0.0)
        self.trace = Trace()
        self.link = Link(PLAIN, 9600, TURNAROUND_S, self, self.roster, self.trace)
        self.link.attach(self, 9600)

    def send(self, request: Request) -> None:
        """Begin an exchange."""
        ending = self.link.send(self.link.prepare(request))
        assert ending is not None
        self.exchanges.append(ending)

    @property
    def results(self) -> list[ExchangeResult]:
        """Of those that have ended."""
        return [exchange.result.result(self) for exchange in self.exchanges if exchange.is_set]

    # the port
    def write(self, data: bytes) -> None:
        self.written.append(data)

    def listen(self, *, now: bool) -> None:
        self.listens = now
        if now:
            gathered, self.gathered = self.gathered, b""
            if gathered:
                self.link.data_received(gathered)

    def drop_output(self) -> None:
        self.dropped += 1

    def retune(self, baud: int) -> None:
        """Any rate will do."""

    def check(self) -> list[str]:
        """It is always there."""
        return []

    def close(self) -> None:
        """Nothing to close."""

    # time
    def pass_time(self, seconds: float) -> None:
        self.pass_to(self.time + seconds)
        self.link.account()

    def receive(self, data: bytes) -> None:
        """Byte by byte, each in its time."""
        for value in data:
            self.pass_time(BYTE_S)
            if self.listens:
                self.link.data_received(bytes((value,)))
            else:
                self.gathered += bytes((value,))
        self.link.account()

    def respond(self, reply: Reply = STATUS, after_s: float = 0.005) -> None:
        """As a unit would: after the request has left."""
        self.pass_time(len(self.written[-1]) * BYTE_S + after_s)
        self.receive(encode_reply(reply, PLAIN))


@pytest.fixture
async def wires() -> Wires:
    return Wires()


async def test_a_response_is_taken_with_its_times(wires: Wires) -> None:
    began = wires.time
    wires.send(ReadStatusRequest(1))
    wires.respond(after_s=0.005)
    result = wires.results[0]
    assert result.reply == STATUS
    assert result.sent_at == pytest.approx(began + 7 * BYTE_S)
    assert result.responded_at == result.ended == pytest.approx(began + 25 * BYTE_S + 0.005)
    times = wires.roster[1].statistics.times
    assert times.largest == pytest.approx(0.005, abs=1e-6)


async def test_a_timeout_ends_with_the_turnaround(wires: Wires) -> None:
    began = wires.time
    wires.send(ReadStatusRequest(1))
    wires.pass_time(1.0)
    result = wires.results[0]
    assert result.reply is None
    assert result.ended - began == pytest.approx(7 * BYTE_S + TURNAROUND_S + MARGIN_S)
    assert wires.dropped == 1, "what has not left by then leaves no more"
    assert wires.roster[1].statistics.counts.timeouts == 1


async def test_a_response_that_begins_at_the_last_moment_is_waited_for(wires: Wires) -> None:
    wires.send(ReadStatusRequest(1))
    wires.respond(after_s=TURNAROUND_S)
    assert wires.results[0].reply == STATUS


async def test_a_duplicate_comes_too_early_to_be_the_next_response(wires: Wires) -> None:
    wires.send(ReadStatusRequest(1))
    wires.respond()
    wires.send(ReadStatusRequest(1))
    wires.receive(encode_reply(STATUS, PLAIN))
    assert len(wires.results) == 1, "it is there before the request has left"
    newer = StatusReply(1, 600, 600, 77, 0xC0, 0x03)
    wires.respond(newer, after_s=0.0)
    assert wires.results[1].reply == newer
    assert wires.roster[1].statistics.counts.late == 1


@given(st.lists(st.booleans(), max_size=300))
def test_pace_is_never_stuck(history: list[bool]) -> None:
    """After any history, early responses alone, or responses on time alone, are soon believed."""
    pace = PortPace()
    for early in history:
        pace.believes(0.5 if early else 1.0, 1.0)
    for early in (True, False):
        assert any(pace.believes(0.5 if early else 1.0, 1.0) for _ in range(3))


async def test_a_damaged_response_ends_the_wait_at_once(wires: Wires) -> None:
    wires.send(ReadStatusRequest(1))
    spoilt = bytearray(encode_reply(STATUS, PLAIN))
    spoilt[5] ^= 1
    wires.pass_time(7 * BYTE_S)
    wires.receive(bytes(spoilt))
    wires.pass_time(0.02)
    assert wires.results[0].reply is None
    assert wires.results[0].noise.garbled
    assert wires.roster[1].statistics.counts.checksum_errors == 1


async def test_bytes_without_end_do_not_hold_the_window_open(wires: Wires) -> None:
    wires.send(ReadStatusRequest(1))
    wires.receive(bytes(200))
    assert len(wires.results) == 1
    assert wires.results[0].ended - 100.0 < 0.12
    assert wires.link.counts.noise_bytes > 0


async def test_a_lost_port_gives_back_what_was_under_way(wires: Wires) -> None:
    wires.send(SetAndExecuteSpeedRequest(1, 640))
    wires.link.lose(GONE)
    (result,) = wires.results
    assert (result.request, result.reply) == (SetAndExecuteSpeedRequest(1, 640), None)
    wires.pass_time(1.0)
    assert not wires.link.open
    assert wires.link.loss == GONE
    sent = len(wires.written)
    assert wires.link.send(wires.link.prepare(ReadStatusRequest(1))) is None
    assert len(wires.written) == sent


# --- the trace -----------------------------------------------------------------------------------


async def test_a_secret_passes_without_its_bytes(wires: Wires) -> None:
    wires.send(ReadParameterRequest(1, 21))
    wires.respond(ParameterReply(1, 4242))
    for passed in wires.trace.since(0.0):
        assert passed.data == b""
        assert Interpreter(PLAIN).frame(passed).meaning == str(HIDDEN)
    assert wires.results[0].frame == b""


SECRET = ParameterReply(1, 9876)
SECRET_BYTES = (9876).to_bytes(4, "big")
"""Without a 10h, which is doubled on the wire."""


def kept(wires: Wires) -> bytes:
    """All bytes in the trace."""
    return b"".join(passed.data for passed in wires.trace.since(0.0))


def timed_out(wires: Wires, request: Request) -> None:
    """Let the exchange end without a response."""
    wires.send(request)
    wires.pass_time(1.0)
    assert wires.results[-1].reply is None


@pytest.mark.parametrize("request_", [ReadParameterRequest(1, 21), WriteParameterRequest(1, 21, 9876)])
@pytest.mark.parametrize("later_s", [0.0, 600.0])
async def test_a_secret_that_comes_late_is_kept_without_its_bytes(
    wires: Wires, request_: Request, later_s: float
) -> None:
    timed_out(wires, request_)
    wires.pass_time(later_s)
    wires.send(ReadStatusRequest(1))
    wires.respond(SECRET)
    wires.respond()
    assert wires.results[-1].reply == STATUS
    assert SECRET_BYTES not in kept(wires)
    assert kept(wires).endswith(encode_reply(STATUS, PLAIN)), "bytes that are no response are kept"


async def test_a_piece_of_a_secret_is_kept_without_its_bytes(wires: Wires) -> None:
    """The port is lost in the middle of it, or its checksum is."""
    wires.send(ReadParameterRequest(1, 21))
    spoilt = bytearray(encode_reply(SECRET, PLAIN))
    spoilt[-1] ^= 0xFF
    wires.pass_time(0.02)
    wires.receive(bytes(spoilt))
    wires.pass_time(1.0)
    wires.link.lose(GONE)
    wires.link.attach(wires, 9600)
    wires.receive(encode_reply(SECRET, PLAIN))
    assert SECRET_BYTES not in kept(wires)


async def test_bytes_that_are_no_response_are_kept_while_no_secret_can_come(wires: Wires) -> None:
    wires.send(ReadParameterRequest(1, 21))
    wires.respond(SECRET)
    wires.send(ReadStatusRequest(1))
    wires.respond()
    wires.pass_time(SECRET_LINGERS_S)
    wires.send(ReadStatusRequest(1))
    wires.respond(ParameterReply(1, 777))
    wires.pass_time(1.0)
    assert (777).to_bytes(4, "big") in kept(wires)


def test_the_trace_is_bounded_by_time_and_by_bytes() -> None:
    trace = Trace(kept_s=100.0, kept_bytes=400_000)
    for number in range(60_000):
        trace.add(TracedFrame(number * 0.001, "in", bytes(20)))
    assert trace.size <= 400_000 + 70_000
    for number in range(600):
        trace.add(TracedFrame(1000.0 + number / 60, "in", bytes(1_000)))
    assert next(trace.since(0.0)).at >= 60.0 - 1


async def test_of_noise_without_end_the_beginning_is_kept(wires: Wires) -> None:
    """A server that floods the port comes in pieces of any size."""
    followed: list[TracedFrame] = []
    wires.trace.follower = followed.append
    wires.link.data_received(bytes(100_000))
    assert [len(passed.data) for passed in wires.trace.since(0.0)] == [MAX_FRAME]
    assert [len(passed.data) for passed in followed] == [MAX_FRAME]
    assert wires.link.counts.noise_bytes == 100_000


async def test_what_noise_means_is_bounded(wires: Wires) -> None:
    many = b"".join(encode_reply(Ack(unit), PLAIN) for unit in range(1, 100))
    wires.link.data_received(many)
    (passed,) = wires.trace.since(0.0)
    assert len(Interpreter(PLAIN).frame(passed).meanings) == MAX_MEANINGS


async def test_a_broadcast_is_left_to_leave() -> None:
    line = Wires()
    line.send(ExecuteSpeedRequest(0))
    line.pass_time(0.1)
    assert line.results[-1].request == ExecuteSpeedRequest(0)
    assert line.dropped == 0, "it has no response, so its end does not show whether it has left"
    line.send(ReadStatusRequest(1))
    line.pass_time(1.0)
    assert line.dropped == 1


async def test_bytes_gather_until_a_response_can_be_complete() -> None:
    line = Wires()
    line.send(ReadStatusRequest(1))
    assert line.listens, "how fast the port is shows at its first response"
    line.respond(after_s=0.0)
    line.send(ReadStatusRequest(2))
    assert not line.listens
    line.respond(replace(STATUS, unit=2), after_s=0.0)
    result = line.results[-1]
    assert result.reply == replace(STATUS, unit=2)
    assert result.ended == pytest.approx(100.0 + 2 * 25 * BYTE_S)
    assert line.roster[2].statistics.times.largest == pytest.approx(0.0, abs=0.0002)


async def test_a_response_found_after_a_stall_is_as_old_as_its_window() -> None:
    line = Wires()
    line.send(ReadStatusRequest(1))
    line.time += 3600.0
    line.link.data_received(encode_reply(STATUS, PLAIN))
    result = line.results[-1]
    assert result.reply == STATUS
    assert result.responded_at is not None
    assert result.responded_at < 101.0, "a value is never newer than it can be"


def _paced() -> Wires:
    """A port that is known to be as slow as its baud rate."""
    line = Wires()
    line.send(ReadStatusRequest(2))
    line.respond(replace(STATUS, unit=2))
    return line


async def test_a_response_that_comes_alone_and_in_time_is_ordinary() -> None:
    line = _paced()
    line.send(ReadStatusRequest(1))
    line.respond()
    assert line.exchanges[-1].result.is_ordinary


async def test_what_follows_is_after_the_response_in_the_trace() -> None:
    line = _paced()
    line.send(ReadStatusRequest(1))
    following = line.link.prepare(ReadStatusRequest(2))
    line.pass_time(25 * BYTE_S)
    line.link.data_received(encode_reply(STATUS, PLAIN))
    line.link.send(following)
    ways = [passed.direction for passed in line.trace.since(0.0)]
    assert ways == ["out", "in", "out", "in", "out"]
    line.respond(replace(STATUS, unit=2))
    assert following.reply == replace(STATUS, unit=2)


async def test_a_response_with_which_more_came_is_not_ordinary() -> None:
    line = _paced()
    line.send(ReadStatusRequest(1))
    line.pass_time(25 * BYTE_S)
    line.link.data_received(encode_reply(STATUS, PLAIN) + encode_reply(replace(STATUS, unit=7), PLAIN))
    ended = line.exchanges[-1].result
    assert ended.exchange.reply == STATUS
    assert not ended.is_ordinary
    line.link.account()
    assert line.roster[1].statistics.counts.foreign == 1


async def test_a_port_that_takes_nothing_is_lost() -> None:
    line = _paced()

    def broken(_data: bytes) -> None:
        raise WireError(GONE)

    line.write = broken  # type: ignore[method-assign]
    assert line.link.send(line.link.prepare(ReadStatusRequest(1))) is None
    assert line.link.loss == GONE


async def test_a_request_that_left_in_part_may_have_been_received() -> None:
    line = _paced()

    def broken(data: bytes) -> None:
        raise PartlySent(Message.of("port_partly_sent", port="p", sent=3, all=len(data)))

    line.write = broken  # type: ignore[method-assign]
    line.send(SetAndExecuteSpeedRequest(1, 640))
    assert line.results[-1].reply is None
    assert not line.link.open


async def test_an_overdue_response_of_another_unit_is_reported_once() -> None:
    line = Wires()
    line.send(ReadStatusRequest(2))
    line.pass_time(1.0)
    line.send(ReadStatusRequest(1))
    line.respond(replace(STATUS, unit=2))
    line.respond()
    assert line.results[-1].overdue == (2,)
    line.send(ReadStatusRequest(1))
    line.respond()
    assert line.results[-1].overdue == ()


async def test_what_awaits_it_has_run_when_set_returns() -> None:
    first: Completion[int] = Completion()
    second: Completion[int] = Completion()
    received: list[int] = []

    async def steps() -> str:
        received.append(await first)
        received.append(await second)
        return "over"

    running = asyncio.create_task(run_at_once(steps()))
    await asyncio.sleep(0)
    first.set(1)
    assert received == [1]
    second.set(2)
    assert received == [1, 2]
    assert await running == "over"


async def test_a_result_set_before_it_is_awaited_is_no_wait() -> None:
    completion: Completion[int] = Completion()

    async def steps() -> int:
        completion.set(7)
        return await completion

    assert await run_at_once(steps()) == 7


async def test_an_error_ends_what_runs_it_and_not_what_sets_it() -> None:
    completion: Completion[None] = Completion()

    async def steps() -> None:
        await completion
        raise ValueError("broken")

    running = asyncio.create_task(run_at_once(steps()))
    await asyncio.sleep(0)
    completion.set(None)
    with pytest.raises(ValueError, match="broken"):
        await running


async def test_a_coroutine_that_is_canceled_is_closed_and_not_resumed() -> None:
    completion: Completion[None] = Completion()
    events: list[str] = []

    async def steps() -> None:
        try:
            await completion
            events.append("resumed")
        finally:
            events.append("closed")

    running = asyncio.create_task(run_at_once(steps()))
    await asyncio.sleep(0)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    completion.set(None)
    assert events == ["closed"]
