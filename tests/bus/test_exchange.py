"""One exchange: which frame is the response, what every other is, and what a late or second one needs."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.settings import Dialect
from bus.wire.commands import (
    Ack,
    ExecuteSpeedRequest,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    StatusReply,
    WriteAnalogOutputRequest,
    WriteOutputRequest,
    WriteParameterRequest,
    encode_reply,
    encode_request,
    is_write,
)
from bus.wire.exchange import (
    LONG_RUN,
    MAX_OUTSTANDING,
    Duplicate,
    Echo,
    Exchange,
    ExchangeEvent,
    Foreign,
    Late,
    PendingByUnit,
    PendingResponses,
    Responded,
    Unexpected,
    possible_shapes,
)
from bus.wire.framing import ACK, NAK, DoubledChecksum, Fault, Noise

PLAIN = Dialect()
STATUS = StatusReply(4, 1000, 999, 128, 0xC1, 0x03)


def frame(reply: Reply) -> bytes:
    return encode_reply(reply, PLAIN)


def kinds(events: list[ExchangeEvent]) -> list[type]:
    return [type(event) for event in events]


def test_the_request_is_sent() -> None:
    assert Exchange(StageSpeedRequest(4, 528), PLAIN).sent == encode_request(StageSpeedRequest(4, 528), PLAIN)


def test_the_exchange_of_a_password_is_secret() -> None:
    assert Exchange(WriteParameterRequest(1, 21, 4711), PLAIN).secret
    assert not Exchange(ReadParameterRequest(1, 20), PLAIN).secret


def test_the_response() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    (event,) = exchange.receive(frame(STATUS), 1.5)
    assert isinstance(event, Responded)
    assert event.reply == STATUS == exchange.reply
    assert not exchange.awaiting
    assert exchange.first_byte_at == 1.5
    assert exchange.pending.outstanding == ()


def test_a_response_began_before_its_first_byte_was_there() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    assert exchange.response_began(2.0, 0.01) == 2.0
    exchange.receive(frame(STATUS)[:2], 1.5)
    exchange.receive(frame(STATUS)[2:], 1.75)
    assert exchange.frame == frame(STATUS)
    assert exchange.response_began(1.75, 0.001) == pytest.approx(1.5 - 0.001)


def test_a_first_byte_that_gathered_came_earlier_than_it_was_read() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    exchange.receive(frame(STATUS), 1.75)
    assert exchange.response_began(1.75, 0.01) == pytest.approx(1.75 - 18 * 0.01)


def test_a_response_byte_by_byte_is_timed_by_its_first_byte() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    events = [
        event for at, byte in enumerate(frame(STATUS)) for event in exchange.receive(bytes((byte,)), at)
    ]
    assert kinds(events) == [Responded]
    assert exchange.first_byte_at == 0


def test_the_response_of_another_unit_is_foreign() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    (event,) = exchange.receive(frame(StatusReply(5, 1, 1, 1, 1, 1)), 0.0)
    assert isinstance(event, Foreign)
    assert event.unit == 5
    assert exchange.awaiting


@pytest.mark.parametrize("reply", [Ack(4), ParameterReply(4, 7, 1), Ack(4, b"\x00" * 10)], ids=str)
def test_a_response_of_the_wrong_length_is_unexpected(reply: Reply) -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    assert kinds(exchange.receive(frame(reply), 0.0)) == [Unexpected]
    assert exchange.awaiting


@pytest.mark.parametrize("cut", [0, 1, 5, 8])
def test_an_echo_and_its_response_in_one_piece(cut: int) -> None:
    exchange = Exchange(SetAndExecuteSpeedRequest(4, 5), PLAIN)
    together = exchange.sent + frame(Ack(4))
    at = len(exchange.sent) + cut
    events = exchange.receive(together[:at], 1.0) + exchange.receive(together[at:], 2.0)
    assert kinds(events) == [Echo, Responded]
    assert exchange.first_byte_at == (1.0 if cut else 2.0)


def test_a_second_copy_of_the_response_is_a_duplicate() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    assert kinds(exchange.receive(frame(STATUS) * 2, 0.0)) == [Responded, Duplicate]


def test_another_frame_after_the_response_is_late() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    assert kinds(exchange.receive(frame(STATUS) + frame(Ack(4)), 0.0)) == [Responded, Late]


def test_a_response_after_the_timeout_is_late_and_ends_the_pending_one() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    exchange.give_up()
    assert exchange.pending.outstanding == (ReadStatusRequest(4),)
    assert kinds(exchange.receive(frame(STATUS), 0.0)) == [Late]
    assert exchange.reply is None
    assert exchange.pending.outstanding == ()


def test_nothing_is_awaited_after_a_broadcast() -> None:
    exchange = Exchange(ExecuteSpeedRequest(0), PLAIN)
    assert not exchange.awaiting
    assert kinds(exchange.receive(exchange.sent + frame(Ack(4)), 0.0)) == [Echo, Foreign]
    assert exchange.pending.outstanding == ()


def test_a_damaged_response_is_noise_with_a_checksum_fault() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    spoilt = bytearray(frame(STATUS))
    spoilt[5] ^= 1
    (event,) = exchange.receive(bytes(spoilt), 0.0)
    assert isinstance(event, Noise)
    assert event.reason is Fault.CHECKSUM
    assert event.body[:2] == b"\x04\x06"
    assert exchange.awaiting


def test_the_response_between_noise() -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    events = exchange.receive(b"\xff\x00" + frame(STATUS) + b"\x55\x10\x02", 0.0)
    assert kinds(events) == [Noise, Responded, Noise]


def test_a_doubled_checksum_byte_passes_into_the_next_exchange_without_noise() -> None:
    first = Exchange(WriteOutputRequest(234, 1, True), PLAIN)
    response = frame(Ack(234))
    assert response[-1] == 0x10
    first.receive(response, 0.0)
    second = Exchange(ReadStatusRequest(4), PLAIN, decoder=first.decoder)
    assert kinds(second.receive(b"\x10" + frame(STATUS), 1.0)) == [DoubledChecksum, Responded]


def test_a_response_that_may_be_late_is_not_believed() -> None:
    pending = PendingResponses(4, PLAIN).sent(ReadParameterRequest(4, 5))
    exchange = Exchange(ReadParameterRequest(4, 6), PLAIN, pending=pending)
    assert kinds(exchange.receive(frame(ParameterReply(4, 500, 2)), 0.0)) == [Late]
    assert exchange.awaiting
    assert kinds(exchange.receive(frame(Nak(4, 0x82)), 0.1)) == [Responded]


@given(st.lists(st.sampled_from([0x10, 0x02, 0x03, 0x04, 0x06, 0x15, 0x81, 0x80]), max_size=60).map(bytes))
def test_any_bytes_give_at_most_one_response_and_it_is_of_the_unit(data: bytes) -> None:
    exchange = Exchange(ReadStatusRequest(4), PLAIN)
    responses = [event for event in exchange.receive(data, 0.0) if isinstance(event, Responded)]
    assert len(responses) <= 1
    assert all(response.frame.body[0] == 4 for response in responses)
    assert exchange.awaiting == (not responses)


POLL, READ, WRITE = ReadStatusRequest(1), ReadParameterRequest(1, 3), WriteParameterRequest(1, 3, 4)
SPEED, STAGE, OUTPUT = (
    SetAndExecuteSpeedRequest(1, 5),
    StageSpeedRequest(1, 5),
    WriteOutputRequest(1, 1, True),
)
ALL: list[Request] = [
    POLL,
    READ,
    WRITE,
    SPEED,
    STAGE,
    OUTPUT,
    ExecuteSpeedRequest(1),
    WriteAnalogOutputRequest(1, 3),
]
WRITES = [request for request in ALL if is_write(request)]


def fence_needed(timed_out: Request, following: Request) -> bool:
    line = PendingByUnit(PLAIN)
    line.after(PendingResponses(timed_out.unit, PLAIN).sent(timed_out))
    return line.about(following.unit).fence_before(following) is not None


class TestTheTable:
    @pytest.mark.parametrize("following", ALL, ids=str)
    def test_after_a_lost_poll_anything_may_follow(self, following: Request) -> None:
        assert not fence_needed(POLL, following)

    @pytest.mark.parametrize("lost", ALL, ids=str)
    def test_a_poll_may_follow_anything(self, lost: Request) -> None:
        assert not fence_needed(lost, POLL)

    def test_a_lost_parameter_may_be_read_again_but_not_another(self) -> None:
        assert not fence_needed(READ, READ)
        assert fence_needed(READ, ReadParameterRequest(1, 4))

    @pytest.mark.parametrize("lost", WRITES, ids=str)
    @pytest.mark.parametrize("following", WRITES, ids=str)
    def test_writes_pass_for_each_other_even_for_themselves(self, lost: Request, following: Request) -> None:
        assert fence_needed(lost, following)

    def test_the_response_to_86h_may_carry_a_value(self) -> None:
        assert fence_needed(WRITE, READ)
        assert fence_needed(READ, WRITE)

    def test_other_writes_and_parameter_reads_are_distinguished(self) -> None:
        assert not fence_needed(SPEED, READ)
        assert not fence_needed(READ, SPEED)

    def test_another_unit_is_distinguished(self) -> None:
        assert not fence_needed(SPEED, SetAndExecuteSpeedRequest(2, 5))

    def test_a_broadcast_has_no_response_that_could_be_late(self) -> None:
        assert possible_shapes(ExecuteSpeedRequest(0), PLAIN) == frozenset()
        assert (
            PendingResponses(0, PLAIN).sent(ExecuteSpeedRequest(0)).fence_before(ExecuteSpeedRequest(0))
            is None
        )

    @pytest.mark.parametrize("lost", ALL, ids=str)
    def test_the_fence_is_distinct_from_the_lost_response(self, lost: Request) -> None:
        fence = PendingResponses(1, PLAIN).sent(lost).fence()
        assert not is_write(fence)
        assert not fence_needed(lost, fence)


class TestPendingResponses:
    def test_a_poll_sent_before_a_write_verifies_nothing_after_it(self) -> None:
        pending = PendingResponses(1, PLAIN).sent(POLL).sent(SPEED)
        assert pending.fence_before(POLL) == ReadParameterRequest(1, 17)
        assert PendingResponses(1, PLAIN).sent(POLL).fence_before(POLL) is None

    def test_an_ambiguous_illegal_command_is_not_believed(self) -> None:
        assert not PendingResponses(1, PLAIN).sent(POLL).believes(SPEED, b"\x01\x15\x89")
        assert PendingResponses(1, PLAIN).sent(POLL).believes(SPEED, b"\x01\x15\x80")
        assert PendingResponses(1, PLAIN).believes(SPEED, b"\x01\x15\x89")

    def test_a_parameter_response_may_come_twice(self) -> None:
        responded = PendingResponses(1, PLAIN).sent(READ).received(b"\x01\x06\x02")
        assert responded.fence_before(ReadParameterRequest(1, 4)) == POLL
        assert responded.fence_before(READ) is None
        assert responded.fence_before(SPEED) is None
        assert responded.sent(POLL).fence_before(ReadParameterRequest(1, 4)) is None

    def test_the_longest_memory(self) -> None:
        pending = PendingResponses(1, PLAIN)
        for _ in range(3 * MAX_OUTSTANDING):
            pending = pending.sent(POLL)
        assert pending.outstanding == (POLL,) * LONG_RUN
        for _ in range(3 * MAX_OUTSTANDING):
            pending = pending.sent(POLL).sent(READ)
        assert len(pending.outstanding) == MAX_OUTSTANDING

    def test_a_long_run_ends_only_with_a_response_of_another_shape(self) -> None:
        pending = PendingResponses(1, PLAIN)
        for _ in range(2 * LONG_RUN):
            pending = pending.sent(READ)
        for _ in range(2 * LONG_RUN):
            pending = pending.received(b"\x01\x06\x02").moved_on()
        assert pending.fence_before(ReadParameterRequest(1, 4)) == POLL
        pending = pending.sent(POLL).received(bytes((1, ACK, *bytes(11)))).moved_on()
        assert pending.outstanding == ()

    @given(st.lists(st.sampled_from(ALL), max_size=10), st.sampled_from(ALL))
    def test_fences_with_responses_always_lead_to_the_request(
        self, lost: list[Request], wanted: Request
    ) -> None:
        pending = PendingResponses(1, PLAIN)
        for request in lost:
            pending = pending.sent(request)
        fences = 0
        while (fence := pending.fence_before(wanted)) is not None and fence != wanted:
            length = 11 if isinstance(fence, ReadStatusRequest) else 1
            pending = pending.sent(fence).received(bytes((1, ACK, *bytes(length))))
            fences += 1
            assert fences <= len(lost) + 1


class TestPendingByUnit:
    def test_a_request_to_another_unit_discards_the_last_response(self) -> None:
        pending = PendingByUnit(PLAIN)
        pending.after(PendingResponses(1, PLAIN).sent(READ).received(b"\x01\x06\x02"))
        assert pending.about(1).fence_before(ReadParameterRequest(1, 4)) == POLL
        pending.after(PendingResponses(2, PLAIN).sent(ReadStatusRequest(2)))
        assert pending.about(1).fence_before(ReadParameterRequest(1, 4)) is None

    def test_a_lost_request_is_remembered_past_other_units(self) -> None:
        pending = PendingByUnit(PLAIN)
        pending.after(PendingResponses(1, PLAIN).sent(READ))
        pending.after(PendingResponses(2, PLAIN).sent(ReadStatusRequest(2)))
        assert pending.about(1).fence_before(ReadParameterRequest(1, 4)) == POLL

    def test_a_broadcast_needs_no_fence_and_leaves_none(self) -> None:
        pending = PendingByUnit(PLAIN)
        pending.after(PendingResponses(0, PLAIN))
        assert pending.about(0).fence_before(ExecuteSpeedRequest(0)) is None


# --- a unit with arbitrary delays ------------------------------------------------------------------


@dataclass
class Sent:
    """A request with its place in history: how many writes had gone out before it."""

    request: Request
    writes_before: int


@dataclass
class LateUnit:
    """Responds in order; any response may be lost, come much later, or come twice in a row."""

    draw: st.DataObject
    queue: list[tuple[Sent, bytes]] = field(default_factory=list)
    copy: tuple[Sent, bytes] | None = None

    def send(self, sent: Sent) -> None:
        if self.draw.draw(st.integers(0, 5)) > 0:
            self.queue.append((sent, encode_reply(self._response(sent.request), PLAIN)))

    def deliver(self) -> list[tuple[Sent, bytes]]:
        """Return what comes within one window. The duplicate of the last response, if any, comes first."""
        second = [self.copy] if self.copy else []
        count = self.draw.draw(st.integers(0, len(self.queue)))
        came, self.queue = self.queue[:count], self.queue[count:]
        twice = came and self.draw.draw(st.integers(0, 3)) == 0
        self.copy = came[-1] if twice else None
        return second + came

    def _response(self, request: Request) -> Reply:
        choices: list[Reply]
        match request:
            case ReadStatusRequest():
                choices = [StatusReply(1, 1, 1, 1, 1, 1)]
            case ReadParameterRequest():
                choices = [ParameterReply(1, 7, 1), ParameterReply(1, 7, 4), Nak(1, 0x82)]
            case WriteParameterRequest():
                choices = [Ack(1), Ack(1, b"\x07"), Ack(1, bytes(4)), Nak(1, 0x80), Nak(1, 0x82)]
            case _:
                choices = [Ack(1), Nak(1, 0x80)]
        return self.draw.draw(st.sampled_from(choices))


requests = st.sampled_from([*ALL, ReadParameterRequest(1, 4), SetAndExecuteSpeedRequest(1, 6)])


@given(st.lists(requests, min_size=1, max_size=12), st.data())
def test_no_late_or_duplicate_response_is_ever_taken_for_another(
    wanted: list[Request], data: st.DataObject
) -> None:
    unit, pending, writes = LateUnit(data), PendingByUnit(PLAIN), 0
    for context in wanted:
        for _ in range(6):
            request = pending.about(1).fence_before(context) or context
            sent = Sent(request, writes)
            writes += is_write(request)
            exchange = Exchange(request, PLAIN, pending=pending.about(1))
            unit.send(sent)
            for origin, frame in unit.deliver():
                for event in exchange.receive(frame, 0.0):
                    if isinstance(event, Responded):
                        assert origin.request == request
                        assert origin is sent or origin.writes_before == sent.writes_before
                        assert origin is sent or not is_write(request)
            exchange.give_up()
            pending.after(exchange.pending)
            if request == context and exchange.reply is not None:
                break


class TestASecret:
    """The password (#21) may still come in a late response, and then nothing of it is kept or shown."""

    PASSWORD = ReadParameterRequest(1, 21)

    @pytest.mark.parametrize(("request_", "secret"), [(PASSWORD, True), (READ, False)])
    def test_while_a_response_is_outstanding(self, request_: Request, secret: bool) -> None:
        pending = PendingByUnit(PLAIN)
        pending.after(pending.about(1).sent(request_))
        assert pending.may_hold_secret(1) is secret
        assert not pending.may_hold_secret(2)

    def test_while_a_second_copy_may_come(self) -> None:
        came = PendingResponses(1, PLAIN).sent(self.PASSWORD).received(bytes((1, ACK, 4, 210)))
        assert came.outstanding == ()
        assert came.may_hold_secret
        assert not came.moved_on().may_hold_secret


def test_a_frame_that_is_no_response_ends_nothing() -> None:
    waiting = PendingResponses(1, PLAIN).sent(READ)
    for body in (b"\x01", bytes((1, 0x81)), bytes((1, NAK)), bytes((1, NAK, 1, 2))):
        assert waiting.received(body) == waiting
