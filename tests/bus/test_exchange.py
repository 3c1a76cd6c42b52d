"""One exchange: which frame is the response, and what every other one is."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.errors import CallerError
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
    WriteOutputRequest,
    WriteParameterRequest,
    encode_reply,
    encode_request,
)
from bus.wire.exchange import (
    Duplicate,
    Echo,
    Exchange,
    ExchangeEvent,
    Foreign,
    Late,
    PendingResponses,
    Responded,
    Unexpected,
)
from bus.wire.framing import DoubledChecksum, Fault, Noise

PLAIN = Dialect()
STATUS = StatusReply(4, 1000, 999, 128, 0xC1, 0x03)


def frame(reply: Reply) -> bytes:
    return encode_reply(reply, PLAIN)


def kinds(events: list[ExchangeEvent]) -> list[type]:
    return [type(event) for event in events]


def test_the_request_is_sent() -> None:
    assert Exchange(StageSpeedRequest(4, 528), PLAIN).sent == encode_request(StageSpeedRequest(4, 528), PLAIN)


@pytest.mark.parametrize(
    "bad",
    [
        StageSpeedRequest(4, 100_000),
        ReadStatusRequest(0),
        ReadStatusRequest(256),
        ReadParameterRequest(1, 0),
    ],
)
def test_a_bad_request_makes_no_exchange(bad: Request) -> None:
    with pytest.raises(CallerError):
        Exchange(bad, PLAIN)


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
