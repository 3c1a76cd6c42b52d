"""Procedures with scripted responses: when a write is verified, and the message when it is not."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from bus.contract import (
    ExecuteSpeed,
    Reading,
    Result,
    SetSpeed,
    WriteOutput,
    WriteParameter,
)
from bus.line.commands.procedure import CommandContext, Procedure, Unstage, Wait
from bus.line.commands.writes import write_to_unit
from bus.line.roster import Roster, UnitRecord
from bus.line.send import ExchangeResult, Send, SendAttempts, SendResult, SendStatus
from bus.settings import Dialect
from bus.wire.commands import (
    Ack,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StatusReply,
)
from bus.wire.exchange import PendingResponses

REMOTE = 0x40
MASTER, FOLLOWER, PRESET = 0x03, 0x43, 0x07
PLAIN = Dialect()
TAKEN = Ack(1)

Brain = Callable[[Request], Reply | SendStatus]


def play(
    procedure: Procedure, brain: Brain, effects: list[object] | None = None
) -> tuple[Result, list[Request]]:
    """Run it against ``brain``; return the result and the requests. ``effects`` takes what else it does."""
    requests: list[Request] = []
    sent: SendResult | None = None
    try:
        while True:
            step = procedure.send(sent)
            sent = None
            if isinstance(step, Send):
                requests.append(step.request)
                sent = send_result_of(brain(step.request), float(len(requests)))
            elif effects is not None:
                effects.append(step)
    except StopIteration as end:
        return end.value, requests


def send_result_of(response: Reply | SendStatus, at: float) -> SendResult:
    if isinstance(response, SendStatus):
        return SendResult(
            response,
            attempts=0 if response in (SendStatus.TOO_LATE, SendStatus.PORT_CLOSED) else 1,
            sent_at=at,
        )
    return SendResult(SendStatus.RESPONDED, response, attempts=1, sent_at=at, responded_at=at + 0.5)


def status(commanded: int, inputs: int = MASTER, outputs: int = REMOTE) -> StatusReply:
    return StatusReply(1, commanded, commanded, 0, outputs, inputs)


@pytest.fixture
def record() -> UnitRecord:
    roster = Roster([1], 0.0)
    roster.take_response(ReadParameterRequest(1, 8), ParameterReply(1, 0), 0.0, b"")
    roster[1].reading = Reading(1, 0.0, 100, 100, 0, REMOTE, MASTER)
    return roster[1]


def follower(record: UnitRecord) -> UnitRecord:
    Roster.take_response(_of(record), ReadParameterRequest(1, 8), ParameterReply(1, 1), 0.0, b"")
    return record


def _of(record: UnitRecord) -> Roster:
    roster = Roster([1], 0.0)
    roster._records[1] = record
    return roster


CONTEXT = CommandContext(PLAIN)


def set_speed(record: UnitRecord, dialect: Dialect = PLAIN) -> Procedure:
    return write_to_unit(record, SetSpeed(1, 640), CommandContext(dialect))


def brain_of(
    *,
    write: Reply | SendStatus = TAKEN,
    reads: list[Reply | SendStatus],
    ratio: Reply | SendStatus = SendStatus.TIMED_OUT,
) -> Brain:
    left = list(reads)

    def brain(request: Request) -> Reply | SendStatus:
        if isinstance(request, ReadStatusRequest):
            return left.pop(0) if len(left) > 1 else left[0]
        return ratio if isinstance(request, ReadParameterRequest) else write

    return brain


def test_verified_only_by_a_later_exchange_that_shows_it(record: UnitRecord) -> None:
    result, requests = play(set_speed(record), brain_of(reads=[status(640)]))
    assert requests == [SetAndExecuteSpeedRequest(1, 640), ReadStatusRequest(1)]
    assert (result.outcome, result.read_back) == ("verified", 640)
    unit = result.units[0]
    assert (unit.sent_at, unit.acknowledged_at, unit.proven_at) == (1.0, 1.5, 2.5)


def test_a_refusal_is_not_read_back(record: UnitRecord) -> None:
    result, requests = play(set_speed(record), brain_of(write=Nak(1, 0x80), reads=[status(640)]))
    assert len(requests) == 1
    assert (result.outcome, result.unit_error) == ("refused", 0x80)


def test_a_lost_acknowledgement_is_made_good_by_the_read_back(record: UnitRecord) -> None:
    result, _ = play(set_speed(record), brain_of(write=SendStatus.TIMED_OUT, reads=[status(640)]))
    assert result.outcome == "verified"
    assert "not acknowledged" in str(result.message)


def test_a_unit_that_takes_a_moment_is_looked_at_again(record: UnitRecord) -> None:
    result, requests = play(set_speed(record), brain_of(reads=[status(100), status(100), status(640)]))
    assert result.outcome == "verified"
    assert requests.count(ReadStatusRequest(1)) == 3


def test_it_waits_between_its_looks_so_that_others_may_go(record: UnitRecord) -> None:
    procedure = set_speed(record)
    steps, sent = [], None
    for response in (None, TAKEN, None, None, status(100)):
        sent = send_result_of(response, 1.0) if response is not None else None
        steps.append(procedure.send(sent))
    assert isinstance(steps[-1], Wait)


def test_a_read_back_that_differs_is_unverified_with_what_was_read(record: UnitRecord) -> None:
    result, requests = play(set_speed(record), brain_of(reads=[status(100)]))
    assert (result.outcome, result.read_back) == ("unverified", 100)
    assert "reads 100" in str(result.message)
    assert len(requests) == 4, "and the looking ends"


def test_what_stands_above_the_setpoint_is_named(record: UnitRecord) -> None:
    result, _ = play(set_speed(record), brain_of(reads=[status(200, PRESET)]))
    assert "(active: preset)" in str(result.message)


def test_no_read_back_is_unverified(record: UnitRecord) -> None:
    result, _ = play(set_speed(record), brain_of(reads=[SendStatus.TIMED_OUT]))
    assert (result.outcome, result.read_back) == ("unverified", None)
    assert str(result.message).endswith("it did not respond to the read-back: its state is not known")


def test_nothing_sent_is_never_more_than_not_sent(record: UnitRecord) -> None:
    for end, outcome in ((SendStatus.TOO_LATE, "not_sent"), (SendStatus.PORT_CLOSED, "bus_closed")):
        result, requests = play(set_speed(record), brain_of(write=end, reads=[status(640)]))
        assert result.outcome == outcome
        assert len(requests) == 1, "a read-back by chance would prove nothing"


# --- followers -----------------------------------------------------------------------------------


def test_a_follower_is_verified_by_its_ratio(record: UnitRecord) -> None:
    brain = brain_of(reads=[status(1200, FOLLOWER)], ratio=ParameterReply(1, 640))
    result, requests = play(set_speed(follower(record)), brain)
    assert result.outcome == "verified"
    assert requests[-1] == ReadParameterRequest(1, 37)


def test_a_followers_speed_that_happens_to_be_the_number_is_no_proof(record: UnitRecord) -> None:
    follower(record).reading = Reading(1, 0.0, 640, 640, 0, REMOTE, FOLLOWER)
    brain = brain_of(reads=[status(640, FOLLOWER)], ratio=ParameterReply(1, 10000))
    result, _ = play(set_speed(record), brain)
    assert (result.outcome, result.read_back) == ("unverified", 10000)


def test_a_followers_speed_that_became_the_number_is_proof_where_it_has_no_ratio(record: UnitRecord) -> None:
    brain = brain_of(reads=[status(640, FOLLOWER)], ratio=Nak(1, 0x82))
    assert play(set_speed(follower(record)), brain)[0].outcome == "verified"


def test_where_a_followers_cs_is_the_ratio_it_is_compared(record: UnitRecord) -> None:
    dialect = Dialect(follower_speed="ratio")
    result, requests = play(set_speed(follower(record), dialect), brain_of(reads=[status(640, FOLLOWER)]))
    assert result.outcome == "verified"
    assert len(requests) == 2


def test_a_mode_changed_at_the_panel_is_noticed(record: UnitRecord) -> None:
    def brain(request: Request) -> Reply | SendStatus:
        match request:
            case ReadStatusRequest():
                return status(640, FOLLOWER)
            case ReadParameterRequest(number=8):
                return ParameterReply(1, 1)
            case ReadParameterRequest(number=37):
                return ParameterReply(1, 9999)
            case _:
                return TAKEN

    record.reading = Reading(1, 0.0, 640, 640, 0, REMOTE, FOLLOWER)
    assert play(set_speed(record), brain)[0].outcome == "unverified"


# --- the other writes ----------------------------------------------------------------------------


@pytest.mark.parametrize(("shown", "withdraws"), [(100, True), (110, False)])
def test_staging_the_present_speed_withdraws_what_was_staged(
    record: UnitRecord, shown: int, withdraws: bool
) -> None:
    effects: list[object] = []
    stage = write_to_unit(record, SetSpeed(1, 100, execute=False), CONTEXT)
    result, _ = play(stage, brain_of(reads=[status(shown)]), effects)
    assert result.outcome == "acknowledged"
    assert (Unstage(1) in effects) is withdraws


def test_execute_is_verified_only_where_it_is_known_what_was_staged(record: UnitRecord) -> None:
    result, requests = play(write_to_unit(record, ExecuteSpeed(1), CONTEXT), brain_of(reads=[status(640)]))
    assert (result.outcome, len(requests)) == ("acknowledged", 1)
    record.staged = 640
    result, _ = play(write_to_unit(record, ExecuteSpeed(1), CONTEXT), brain_of(reads=[status(640)]))
    assert (result.outcome, result.read_back) == ("verified", 640)
    result, _ = play(write_to_unit(record, ExecuteSpeed(1), CONTEXT), brain_of(reads=[status(630)]))
    assert result.outcome == "unverified"


@pytest.mark.parametrize(("bits", "outcome"), [(0x44, "verified"), (0x40, "unverified"), (0x04, "verified")])
def test_an_output_is_verified_by_its_bit(record: UnitRecord, bits: int, outcome: str) -> None:
    brain = brain_of(reads=[status(0, outputs=bits)])
    assert play(write_to_unit(record, WriteOutput(1, 3, True), CONTEXT), brain)[0].outcome == outcome


def test_a_parameter_is_verified_by_its_value(record: UnitRecord) -> None:
    brain = brain_of(reads=[], ratio=ParameterReply(1, 77))
    assert play(write_to_unit(record, WriteParameter(1, 6, 77), CONTEXT), brain)[0].outcome == "verified"
    result, requests = play(write_to_unit(record, WriteParameter(1, 6, 78), CONTEXT), brain)
    assert (result.outcome, result.read_back) == ("unverified", 77)
    assert len(requests) == 4


# --- one request through its tries ---------------------------------------------------------------


def miss(request: Request) -> ExchangeResult:
    return ExchangeResult(request, None, 1.0, 1.5, 1.0)


def send_until_over(
    attempts: SendAttempts, responds: Callable[[Request], bool], now: float = 0.0
) -> list[Request]:
    """Play it; ``responds`` decides whether a request gets a response. A timeout leaves a possible late
    response.
    """
    pending, sent = PendingResponses(1, PLAIN), []
    while (request := attempts.next_request(now, pending)) is not None:
        sent.append(request)
        pending = pending.sent(request)
        if responds(request):
            reply = status(1) if request == ReadStatusRequest(1) else Ack(1)
            attempts.settle(ExchangeResult(request, reply, 1.0, 1.5, 1.0, 1.5))
            pending = PendingResponses(1, PLAIN)
        else:
            attempts.settle(miss(request))
    return sent


def test_a_read_is_tried_three_times() -> None:
    attempts = SendAttempts(Send(ReadStatusRequest(1)))
    assert send_until_over(attempts, lambda _: False) == [ReadStatusRequest(1)] * 3
    assert attempts.result is not None
    assert (attempts.result.status, attempts.result.attempts) == (SendStatus.TIMED_OUT, 3)


def test_a_write_is_tried_four_times_with_a_fence_before_each_try() -> None:
    write = SetAndExecuteSpeedRequest(1, 640)
    attempts = SendAttempts(Send(write))
    sent = send_until_over(attempts, lambda request: request != write)
    assert sent == [write, ReadStatusRequest(1)] * 3 + [write]
    assert attempts.result is not None
    assert attempts.result.attempts == 4


def test_a_dead_unit_gets_the_write_once_and_then_only_reads() -> None:
    write = SetAndExecuteSpeedRequest(1, 640)
    attempts = SendAttempts(Send(write))
    sent = send_until_over(attempts, lambda _: False)
    assert sent.count(write) == 1
    assert len(sent) == 4


def test_a_write_never_leaves_after_its_deadline() -> None:
    attempts = SendAttempts(Send(SetAndExecuteSpeedRequest(1, 640)), deadline=5.0)
    assert attempts.next_request(5.1, PendingResponses(1, PLAIN)) is None
    assert attempts.result is not None
    assert (attempts.result.status, attempts.result.attempts) == (SendStatus.TOO_LATE, 0)


def test_its_retries_do_not_either() -> None:
    write = SetAndExecuteSpeedRequest(1, 640)
    attempts = SendAttempts(Send(write), deadline=5.0)
    assert attempts.next_request(4.9, PendingResponses(1, PLAIN)) == write
    attempts.settle(miss(write))
    assert attempts.next_request(5.1, PendingResponses(1, PLAIN)) is None
    assert attempts.result is not None
    assert (attempts.result.status, attempts.result.attempts) == (SendStatus.TOO_LATE, 1)


def test_a_read_back_may_follow_the_deadline() -> None:
    attempts = SendAttempts(Send(ReadStatusRequest(1), fresh=True), deadline=5.0)
    assert attempts.next_request(9.0, PendingResponses(1, PLAIN)) == ReadStatusRequest(1)


def test_a_readback_is_fenced_from_an_older_response_of_its_kind() -> None:
    pending = PendingResponses(1, PLAIN).sent(ReadStatusRequest(1))
    fence = SendAttempts(Send(ReadStatusRequest(1), fresh=True)).next_request(0.0, pending)
    assert isinstance(fence, ReadParameterRequest)


def test_a_later_poll_is_fenced_too_and_its_retry_is_not() -> None:
    pending = PendingResponses(1, PLAIN).sent(ReadStatusRequest(1))
    attempts = SendAttempts(Send(ReadStatusRequest(1)))
    fence = attempts.next_request(0.0, pending)
    assert isinstance(fence, ReadParameterRequest)
    assert not attempts.settle(ExchangeResult(fence, Ack(1), 1.0, 1.5, 1.0, 1.5)), (
        "a fence with a response is no retry"
    )
    assert attempts.next_request(0.0, PendingResponses(1, PLAIN)) == ReadStatusRequest(1)
    assert attempts.settle(miss(ReadStatusRequest(1))), "now it is tried again"
    assert attempts.next_request(0.0, pending) == ReadStatusRequest(1)


def test_a_closed_port_ends_it() -> None:
    attempts = SendAttempts(Send(ReadStatusRequest(1)))
    attempts.close()
    assert attempts.result is not None
    assert attempts.result.status is SendStatus.PORT_CLOSED
