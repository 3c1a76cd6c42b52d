"""The eight commands and their responses, both ways; their lengths; which response fits which request."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.errors import CallerError
from bus.settings import Dialect, wire_seconds
from bus.wire.commands import (
    LARGEST_VALUE,
    Ack,
    ExecuteSpeedRequest,
    IllegalRequest,
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
    acknowledged_lengths,
    encode_reply,
    encode_request,
    is_request,
    is_secret,
    is_write,
    least_reply_bytes,
    longest_reply_bytes,
    parse_reply,
    parse_request,
    usual_reply_bytes,
)
from bus.wire.framing import FrameDecoder, ReceivedFrame
from tests.for_each import for_each

BINARY, BCD = Dialect(), Dialect(parameter_numbers="bcd")

EXAMPLE_OF_88H = "88h unit 27, 350 (manual, 88h example)"
units = st.integers(1, 255)
values = st.integers(0, LARGEST_VALUE)
numbers = st.integers(1, 40)
words = st.integers(0, 2**32 - 1)
octets = st.integers(0, 255)
requests: st.SearchStrategy[Request] = st.one_of(
    st.builds(ReadStatusRequest, units),
    st.builds(StageSpeedRequest, units, values),
    st.builds(ExecuteSpeedRequest, st.integers(0, 255)),
    st.builds(SetAndExecuteSpeedRequest, units, values),
    st.builds(ReadParameterRequest, units, numbers),
    st.builds(WriteParameterRequest, units, numbers, values),
    st.builds(WriteOutputRequest, units, st.integers(1, 6), st.booleans()),
    st.builds(WriteAnalogOutputRequest, units, values),
)
one_of_each: list[Request] = [
    ReadStatusRequest(4),
    StageSpeedRequest(4, 528),
    ExecuteSpeedRequest(4),
    SetAndExecuteSpeedRequest(4, 528),
    ReadParameterRequest(4, 16),
    WriteParameterRequest(4, 16, 1),
    WriteOutputRequest(4, 6, True),
    WriteAnalogOutputRequest(4, 350),
]


def body_of(frame: bytes) -> bytes:
    received = FrameDecoder(BINARY).feed(frame)[0]
    assert isinstance(received, ReceivedFrame)
    return received.body


def status(unit: int) -> StatusReply:
    return StatusReply(unit, commanded=1000, actual=999, analog=128, outputs=0xC1, inputs=0x03)


@given(requests, st.sampled_from([BINARY, BCD]))
def test_requests_round_trip(request: Request, dialect: Dialect) -> None:
    assert parse_request(body_of(encode_request(request, dialect)), dialect) == request


@given(units, words, words, octets, octets, octets)
def test_status_round_trips(unit: int, commanded: int, actual: int, analog: int, st2: int, st1: int) -> None:
    reply = StatusReply(unit, commanded, actual, analog, st2, st1)
    assert parse_reply(ReadStatusRequest(unit), body_of(encode_reply(reply, BINARY)), BINARY) == reply


@given(requests.filter(lambda request: request.unit > 0), octets)
def test_any_command_can_be_refused(request: Request, code: int) -> None:
    reply = Nak(request.unit, code)
    assert parse_reply(request, body_of(encode_reply(reply, BINARY)), BINARY) == reply


@pytest.mark.parametrize("width", [1, 2, 4])
def test_a_parameter_may_come_in_one_two_or_four_bytes(width: int) -> None:
    body = body_of(encode_reply(ParameterReply(1, 200, width), BINARY))
    assert len(body) == 2 + width
    assert parse_reply(ReadParameterRequest(1, 12), body, BINARY) == ParameterReply(1, 200, width)


def test_a_dialect_with_one_width_takes_no_other() -> None:
    two_wide = Dialect(parameter_reply_bytes=2)
    body = body_of(encode_reply(ParameterReply(1, 200, 4), BINARY))
    assert parse_reply(ReadParameterRequest(1, 12), body, two_wide) is None
    assert len(encode_reply(ParameterReply(1, 200, 4), two_wide)) == 9


def test_a_response_to_86h_without_ack_as_the_manual_draws_it_is_not_taken() -> None:
    assert parse_reply(WriteParameterRequest(1, 6, 5), b"\x01\x00\x00\x00\x05", BINARY) is None


RESPONSES: dict[str, tuple[bytes, set[int]]] = {
    "ACK": (b"\x06", {0x82, 0x83, 0x84, 0x86, 0x87, 0x88}),
    "ACK and 1 byte": (b"\x06\x01", {0x85, 0x86}),
    "ACK and 2 bytes": (b"\x06\x00\x01", {0x85, 0x86}),
    "ACK and 3 bytes": (b"\x06\x00\x00\x01", set()),
    "ACK and 4 bytes": (b"\x06\x00\x00\x00\x01", {0x85, 0x86}),
    "ACK and 5 bytes": (b"\x06\x00\x00\x00\x00\x01", set()),
    "ACK and 10 bytes": (b"\x06" + bytes(10), set()),
    "ACK and 11 bytes": (b"\x06" + bytes(11), {0x81}),
    "NAK and a code": (b"\x15\x80", set(range(0x81, 0x89))),
    "NAK alone": (b"\x15", set()),
    "NAK and 2 bytes": (b"\x15\x80\x80", set()),
    "a request": (b"\x81", set()),
    "neither": (b"\x00\x00", set()),
}


@for_each("response", RESPONSES)
@for_each("request_", one_of_each)
def test_a_response_is_taken_only_by_commands_that_have_it(request_: Request, response: str) -> None:
    data, commands = RESPONSES[response]
    reply = parse_reply(request_, bytes((request_.unit,)) + data, BINARY)
    assert (reply is not None) == (request_.COMMAND in commands)


def test_a_broadcast_has_no_response() -> None:
    assert parse_reply(ExecuteSpeedRequest(0), b"\x00\x06", BINARY) is None
    assert longest_reply_bytes(ExecuteSpeedRequest(0), BINARY) == 0
    assert usual_reply_bytes(ExecuteSpeedRequest(0), BINARY) == 0
    assert least_reply_bytes(ExecuteSpeedRequest(0), BINARY) == 0


@given(requests, st.binary(max_size=20), st.sampled_from([BINARY, BCD]))
def test_any_body_is_a_response_of_the_addressed_unit_or_none(
    request: Request, body: bytes, dialect: Dialect
) -> None:
    reply = parse_reply(request, body, dialect)
    assert reply is None or (reply.unit == request.unit == body[0] and body[1] in (0x06, 0x15))


@given(st.binary(min_size=2, max_size=13), st.sampled_from([BINARY, BCD]))
def test_any_body_is_a_request_or_refused_with_a_code(body: bytes, dialect: Dialect) -> None:
    try:
        request = parse_request(body, dialect)
    except IllegalRequest as error:
        refused = (error.unit, error.code)
        assert refused in {(body[0], code) for code in (0x82, 0x85, 0x89)}
    else:
        assert is_request(body)
        assert (request.unit, request.COMMAND) == (body[0], body[1])


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b"\x01\x80", 0x89),
        (b"\x01\x89", 0x89),
        (b"\x01\x81\x00", 0x89),
        (b"\x01\x82\x00\x00\x01", 0x89),
        (b"\x01\x87\x01\x02", 0x85),
    ],
)
def test_a_frame_that_is_no_request_has_a_code(body: bytes, code: int) -> None:
    with pytest.raises(IllegalRequest) as refused:
        parse_request(body, BINARY)
    assert refused.value.code == code


def test_a_unit_that_counts_in_bcd() -> None:
    assert body_of(encode_request(ReadParameterRequest(1, 16), BCD))[2] == 0x16
    assert parse_request(b"\x01\x85\x11", BCD) == ReadParameterRequest(1, 11)
    assert parse_request(b"\x01\x85\x11", BINARY) == ReadParameterRequest(1, 17)
    with pytest.raises(IllegalRequest) as refused:
        parse_request(b"\x01\x85\x0a", BCD)
    assert refused.value.code == 0x82


@pytest.mark.parametrize(
    "request_",
    [
        ReadStatusRequest(0),
        ReadStatusRequest(256),
        StageSpeedRequest(0, 1),
        StageSpeedRequest(1, -1),
        StageSpeedRequest(1, 100_000),
        SetAndExecuteSpeedRequest(1, 100_000),
        ExecuteSpeedRequest(-1),
        ReadParameterRequest(1, 0),
        ReadParameterRequest(1, 256),
        WriteParameterRequest(1, 1, 100_000),
        WriteOutputRequest(1, 0, True),
        WriteOutputRequest(1, 7, True),
        WriteAnalogOutputRequest(1, 100_000),
    ],
    ids=str,
)
def test_a_bad_value_never_becomes_bytes(request_: Request) -> None:
    with pytest.raises(CallerError, match="cannot be sent"):
        encode_request(request_, BINARY)


@pytest.mark.parametrize(
    "reply", [ParameterReply(1, 256, 1), Nak(1, 256), Ack(256), Ack(1, bytes(12))], ids=str
)
def test_a_reply_that_does_not_fit_is_refused(reply: Reply) -> None:
    with pytest.raises(CallerError):
        encode_reply(reply, BINARY)


@given(requests, st.sampled_from([BINARY, Dialect(checksum_10h="twice")]))
def test_no_response_is_longer_than_the_longest(request: Request, dialect: Dialect) -> None:
    longest = longest_reply_bytes(request, dialect)
    for data, commands in RESPONSES.values():
        if request.COMMAND not in commands or request.unit == 0:
            continue
        stuffed = 5 + 2 * (1 + len(data)) - 1
        assert stuffed <= longest
    assert least_reply_bytes(request, dialect) <= usual_reply_bytes(request, dialect) <= longest


def test_the_costs_of_protocol_md() -> None:
    """A poll is 7 + 18 bytes, 26.04 ms at 9600 baud; 38.4 of them fit a second."""
    requested = len(encode_request(ReadStatusRequest(4), BINARY))
    responded = len(encode_reply(status(4), BINARY))
    assert (requested, responded) == (7, 18)
    assert usual_reply_bytes(ReadStatusRequest(4), BINARY) == 18
    assert least_reply_bytes(ReadStatusRequest(4), BINARY) == 18
    assert wire_seconds(requested + responded, 9600) == pytest.approx(0.02604, abs=1e-5)


def test_only_reads_are_not_writes() -> None:
    assert [request.COMMAND for request in one_of_each if not is_write(request)] == [0x81, 0x85]


def test_the_manuals_example_encodes() -> None:
    vectors: list[dict[str, Any]] = json.loads(
        (Path(__file__).parent.parent / "vectors" / "frames.json").read_text()
    )
    frames = {vector["meaning"]: bytes.fromhex(vector["frame"]) for vector in vectors}
    assert encode_request(StageSpeedRequest(4, 528), BINARY) == frames["82h unit 4, 528 (manual)"]
    assert encode_request(WriteAnalogOutputRequest(27, 350), BINARY) == frames[EXAMPLE_OF_88H]
    assert encode_request(ExecuteSpeedRequest(0), BINARY) == frames["83h to all"]
    assert encode_reply(status(1), BINARY) in frames.values()


def test_what_has_the_password_is_secret() -> None:
    assert is_secret(WriteParameterRequest(1, 21, 4711))
    assert is_secret(ReadParameterRequest(1, 21))
    assert not is_secret(ReadParameterRequest(1, 20))
    assert not is_secret(ReadParameterRequest(1, 41))
    assert not is_secret(ReadStatusRequest(1))


PLAIN, TWO_BYTES, DOUBLED = Dialect(), Dialect(parameter_reply_bytes=2), Dialect(checksum_10h="twice")


def test_a_dialect_may_fix_the_width_of_a_read_parameter_and_of_nothing_else() -> None:
    assert acknowledged_lengths(ReadParameterRequest(1, 3), TWO_BYTES) == {2}
    assert acknowledged_lengths(WriteParameterRequest(1, 3, 4), TWO_BYTES) == {0, 1, 2, 4}


@pytest.mark.parametrize(
    ("request_", "dialect", "usual", "longest"),
    [
        # 10 02 UID ACK, data, 10 03 checksum; the longest has every byte of its body doubled.
        (ReadStatusRequest(1), PLAIN, 18, 31),
        (ReadParameterRequest(1, 3), PLAIN, 11, 17),
        (ReadParameterRequest(1, 3), TWO_BYTES, 9, 13),
        (ReadParameterRequest(1, 3), Dialect(parameter_reply_bytes=4), 11, 17),
        (StageSpeedRequest(1, 5), PLAIN, 8, 11),
        (WriteParameterRequest(1, 3, 1), PLAIN, 11, 17),
        (StageSpeedRequest(1, 5), DOUBLED, 8, 12),
        (ExecuteSpeedRequest(0), DOUBLED, 0, 0),
    ],
)
def test_bytes_on_the_wire(request_: Request, dialect: Dialect, usual: int, longest: int) -> None:
    assert usual_reply_bytes(request_, dialect) == usual
    assert longest_reply_bytes(request_, dialect) == longest


def test_a_byte_is_ten_bits() -> None:
    assert wire_seconds(960, 9600) == 1.0
