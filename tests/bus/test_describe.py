"""Frames in words and as fields."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.settings import Dialect
from bus.wire.commands import (
    Ack,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    StatusReply,
    WriteParameterRequest,
    encode_reply,
    encode_request,
)
from bus.wire.describe import Described, DescribedNoise, describe_bytes

PLAIN = Dialect()
FRAMES: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent.parent / "vectors" / "frames.json").read_text()
)


def only(data: bytes) -> Described:
    (described,) = describe_bytes(data)
    assert isinstance(described, Described)
    return described


@pytest.mark.parametrize("vector", FRAMES, ids=lambda vector: vector["meaning"])
def test_vectors(vector: dict[str, Any]) -> None:
    described = only(bytes.fromhex(vector["frame"]))
    assert described.as_json() == {
        "uid": vector["uid"],
        "kind": vector["kind"],
        "fields": vector["fields"],
        "checksum_ok": True,
    }


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        ("10 02 04 82 00 00 02 10 10 10 03 68", "unit 4: set speed (staged) 528"),
        ("10 02 00 83 10 03 7D", "all units: execute speed"),
        ("10 02 01 85 10 10 10 03 6A", "unit 1: read Allow Setup During Run (parameter 16)"),
        ("10 02 05 87 06 01 10 03 6D", "unit 5: write auxiliary output 6 on"),
        ("10 02 01 15 89 10 03 61", "unit 1: NAK, illegal command"),
        ("10 02 04 06 10 03 F6", "unit 4: ACK, write accepted"),
        (
            "10 02 01 06 00 00 03 E8 00 00 03 E7 80 C1 03 10 03 E0",
            "unit 1: commanded 1000, actual 999, analog 128; at speed; REMOTE; output 1 on; run",
        ),
    ],
)
def test_words(frame: str, words: str) -> None:
    assert str(only(bytes.fromhex(frame)).meaning) == words


def test_the_value_of_a_parameter_without_its_request_is_described_as_ambiguous() -> None:
    alone = only(encode_reply(ParameterReply(1, 5, 4), PLAIN))
    assert alone.fields == {"raw": 5, "width": 4}
    assert "only the request shows" in str(alone.meaning)


def test_the_request_before_it_determines_the_meaning_of_a_response() -> None:
    request, response = (
        encode_request(ReadParameterRequest(1, 6), PLAIN),
        encode_reply(ParameterReply(1, 50, 2), PLAIN),
    )
    described = describe_bytes(request + response)[1]
    assert isinstance(described, Described)
    assert described.fields == {"number": 6, "name": "Acceleration Ramp Rate", "raw": 50}
    assert str(described.meaning) == "unit 1: Acceleration Ramp Rate (parameter 6) is 50"


def test_a_response_to_a_parameter_write_with_a_value() -> None:
    request = encode_request(WriteParameterRequest(1, 6, 50), PLAIN)
    described = describe_bytes(request + encode_reply(Ack(1, b"\x00\x32"), PLAIN))[1]
    assert isinstance(described, Described)
    assert (described.kind, described.fields) == ("ack", {"raw": 50, "width": 2})
    refused = describe_bytes(request + encode_reply(Nak(1, 0x80), PLAIN))[1]
    assert str(refused.meaning) == "unit 1: NAK to write parameter, unit is not in REMOTE mode"


def test_the_response_of_another_unit_is_described_alone() -> None:
    described = describe_bytes(
        encode_request(ReadParameterRequest(1, 6), PLAIN) + encode_reply(ParameterReply(2, 50, 2), PLAIN)
    )[1]
    assert "only the request shows" in str(described.meaning)


def test_a_wrong_checksum_is_listed_as_such() -> None:
    described = only(bytes.fromhex("10 02 04 82 00 00 02 10 10 10 03 67"))
    assert not described.checksum_ok
    assert (described.uid, described.kind, described.fields) == (4, "set_speed", {"raw": 528})
    assert str(described.meaning).startswith("checksum wrong, 68h would be right")


@pytest.mark.parametrize(
    "body", ["01 99", "01 81 00", "01 87 01 07", "01 06 00 00 00", "01 15", "01 06" + " 00" * 10, "00 00"]
)
def test_a_good_frame_that_means_nothing_is_unknown(body: str) -> None:
    content = bytes.fromhex(body)
    frame = b"\x10\x02" + content + b"\x10\x03" + bytes((-sum(content) & 0xFF,))
    assert only(frame).kind == "unknown"


def test_noise_is_described() -> None:
    (described,) = describe_bytes(b"\x55\xaa")
    assert isinstance(described, DescribedNoise)
    assert (described.wire, str(described.meaning)) == (
        b"\x55\xaa",
        "2 bytes that are no frame: outside a frame",
    )


def test_a_doubled_checksum_byte_is_not_listed() -> None:
    assert len(describe_bytes(bytes.fromhex("10 02 6F 81 10 03 10 10"))) == 1


def test_the_password_is_in_no_words() -> None:
    request = encode_request(WriteParameterRequest(1, 21, 4711), PLAIN)
    read = encode_request(ReadParameterRequest(1, 21), PLAIN) + encode_reply(ParameterReply(1, 4711), PLAIN)
    for described in describe_bytes(request + read):
        assert "4711" not in str(described.meaning)


@given(
    st.lists(st.sampled_from([0x10, 0x02, 0x03, 0x01, 0x06, 0x15, 0x85, 0x86, 0x87]), max_size=80).map(bytes)
)
def test_anything_can_be_described(data: bytes) -> None:
    described = describe_bytes(data)
    assert sum(len(item.wire) for item in described) <= len(data)
    json.dumps([item.as_json() for item in described if isinstance(item, Described)])


def test_a_status_is_the_same_with_its_request_before_it() -> None:
    status = encode_reply(StatusReply(1, 500, 490, 7, 0x40, 0x03), PLAIN)
    request = encode_request(ReadStatusRequest(1), PLAIN)
    assert describe_bytes(request + status)[1] == only(status)
