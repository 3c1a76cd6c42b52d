"""Framing: stuffing, checksum, resynchronisation; the same events however the bytes are cut."""

from __future__ import annotations

import json
import random
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bus.errors import CallerError
from bus.settings import Dialect
from bus.wire.framing import (
    MAX_BODY,
    MAX_NOISE,
    DoubledChecksum,
    Fault,
    FrameDecoder,
    Noise,
    Received,
    ReceivedFrame,
    checksum,
    encode_frame,
)
from tests.bus.reference_decoder import reference_frame, reference_frames

VECTORS = Path(__file__).parent.parent / "vectors"
FRAMES: list[dict[str, Any]] = json.loads((VECTORS / "frames.json").read_text())
STREAMS: list[dict[str, Any]] = json.loads((VECTORS / "streams.json").read_text())
ONCE, TWICE = Dialect(), Dialect(checksum_10h="twice")

# Bytes that mean something come more often than chance would have them.
awkward_bytes = st.sampled_from([0x10, 0x10, 0x02, 0x03, 0x06, 0x15, 0x81, 0x00, 0x01])
byte = awkward_bytes | st.integers(0, 255)
bodies = st.lists(byte, min_size=2, max_size=MAX_BODY).map(bytes)
noise = st.lists(byte, max_size=80).map(bytes)
good_frames = bodies.map(lambda body: encode_frame(body, ONCE))
streams = st.lists(noise | good_frames, max_size=12).map(b"".join)


def everything(data: bytes, cuts: list[int] | None = None) -> list[Received]:
    decoder = FrameDecoder(ONCE)
    edges = [0, *sorted(cuts or []), len(data)]
    events = [event for a, b in pairwise(edges) for event in decoder.feed(data[a:b])]
    return events + decoder.flush()


def bodies_in(data: bytes) -> list[bytes]:
    return [event.body for event in everything(data) if isinstance(event, ReceivedFrame)]


def wire_of(event: Received) -> bytes:
    return event.wire if isinstance(event, ReceivedFrame) else event.data


@pytest.mark.parametrize("vector", FRAMES, ids=lambda vector: vector["meaning"])
class TestFrameVectors:
    def test_encodes(self, vector: dict[str, Any]) -> None:
        assert encode_frame(bytes.fromhex(vector["body"]), ONCE) == bytes.fromhex(vector["frame"])
        assert reference_frame(bytes.fromhex(vector["body"])) == bytes.fromhex(vector["frame"])

    def test_decodes(self, vector: dict[str, Any]) -> None:
        frame, body = bytes.fromhex(vector["frame"]), bytes.fromhex(vector["body"])
        assert FrameDecoder(ONCE).feed(frame) == [ReceivedFrame(body, frame)]
        assert reference_frames(frame) == [body]


@pytest.mark.parametrize("vector", STREAMS, ids=lambda vector: vector["meaning"])
def test_stream_vectors(vector: dict[str, Any]) -> None:
    data = bytes.fromhex(vector["stream"])
    expected = [bytes.fromhex(body) for body in vector["bodies"]]
    assert bodies_in(data) == expected
    assert reference_frames(data) == expected


@given(st.lists(bodies, max_size=8), st.sampled_from([ONCE, TWICE]))
def test_frames_back_to_back(sent: list[bytes], dialect: Dialect) -> None:
    events = everything(b"".join(encode_frame(body, dialect) for body in sent))
    assert [event.body for event in events if isinstance(event, ReceivedFrame)] == sent
    assert not any(isinstance(event, Noise) for event in events)


@given(streams, st.lists(st.integers(0, 400), max_size=20))
def test_any_cut_gives_the_same_events(data: bytes, cuts: list[int]) -> None:
    assert everything(data, [min(cut, len(data)) for cut in cuts]) == everything(data)


@given(streams)
def test_events_are_the_bytes_that_came(data: bytes) -> None:
    assert b"".join(wire_of(event) for event in everything(data)) == data


@given(streams)
@example(bytes.fromhex("10 02 10 02 10 10 02 01 81 10 03 7E"))
def test_agrees_with_the_reference_decoder(data: bytes) -> None:
    assert bodies_in(data) == reference_frames(data)


@given(bodies, st.data())
def test_one_wrong_byte_is_never_accepted_as_the_frame(body: bytes, data: st.DataObject) -> None:
    """A sum finds every error in one byte of the content; only where the error makes or unmakes a 10h can it
    shift the frame's end, and then what is accepted is a complete frame with a right checksum.
    """
    frame = encode_frame(body, ONCE)
    position = data.draw(st.integers(0, len(frame) - 1))
    wrong = data.draw(st.integers(0, 255).filter(lambda value: value != frame[position]))
    spoilt = frame[:position] + bytes((wrong,)) + frame[position + 1 :]
    for event in everything(spoilt):
        if isinstance(event, ReceivedFrame):
            assert event.body != body
            assert event.wire[-1] == checksum(event.body)
            assert 0x10 in (wrong, frame[position])


def test_a_checksum_of_10h_may_come_twice() -> None:
    frame = encode_frame(bytes((111, 0x81)), TWICE)
    assert frame.hex() == "10026f8110031010"
    assert everything(frame + frame) == [
        ReceivedFrame(bytes((111, 0x81)), frame[:-1]),
        DoubledChecksum(),
        ReceivedFrame(bytes((111, 0x81)), frame[:-1]),
        DoubledChecksum(),
    ]


def test_a_doubled_checksum_is_known_only_with_the_next_byte() -> None:
    decoder = FrameDecoder(ONCE)
    assert len(decoder.feed(bytes.fromhex("10026f811003 10 10"))) == 1
    assert decoder.pending == 1
    assert decoder.flush() == [DoubledChecksum()]


def test_a_10h_after_another_checksum_is_noise() -> None:
    events = everything(bytes.fromhex("10 02 04 06 10 03 F6 10 55"))
    assert events[1:] == [Noise(b"\x10\x55", Fault.OUTSIDE)]


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        ("55 AA", Fault.OUTSIDE),
        ("10 02 04 10 02", Fault.RESTART),
        ("10 02 04 10 55", Fault.ESCAPE),
        ("10 02" + " 01" * 14, Fault.TOO_LONG),
        ("10 02 10 03", Fault.TOO_SHORT),
        ("10 02 04 06 10 03 F7", Fault.CHECKSUM),
        ("10 02 04 06", Fault.CUT),
    ],
)
def test_noise_has_its_reason(data: str, fault: Fault) -> None:
    first = everything(bytes.fromhex(data))[0]
    assert isinstance(first, Noise)
    assert first.reason is fault


def test_a_wrong_checksum_shows_what_was_meant() -> None:
    assert everything(bytes.fromhex("10 02 04 06 10 03 F7")) == [
        Noise(bytes.fromhex("10 02 04 06 10 03 F7"), Fault.CHECKSUM, b"\x04\x06")
    ]


@pytest.mark.parametrize("length", [0, 1, MAX_BODY + 1])
def test_a_body_that_no_frame_carries(length: int) -> None:
    with pytest.raises(CallerError, match="a frame carries 2 to 13 bytes"):
        encode_frame(bytes(length), ONCE)


FLOODS = {
    "starts": b"\x10\x02",
    "ends": b"\x10\x03",
    "stuffed": b"\x10\x10\x02",
    "escapes": b"\x10",
    "silence": b"\x00",
    "bad frames": b"\x10\x02\x01\x06\x10\x03",
}


@pytest.mark.parametrize("piece", FLOODS.values(), ids=FLOODS.keys())
def test_a_flood_is_held_in_bounded_memory_and_looked_at_a_bounded_number_of_times(piece: bytes) -> None:
    class Counted(bytearray):
        looks = 0

        def __getitem__(self, key: Any) -> Any:
            Counted.looks += 1
            return super().__getitem__(key)

    decoder = FrameDecoder(ONCE)
    decoder._buffer = Counted()
    flood = piece * 10_000
    held = 0
    for at in range(0, len(flood), 16):
        decoder.feed(flood[at : at + 16])
        held = max(held, decoder.pending)
    assert held <= MAX_NOISE
    assert Counted.looks < 60 * len(flood)
    assert bodies_in(flood[:2] + encode_frame(b"\x01\x81", ONCE))[-1:] == [b"\x01\x81"]


def test_a_noisy_line_of_20000_frames_loses_next_to_nothing() -> None:
    """Dropping complete candidates lost 2,517 good frames, going back lost 2."""
    rng = random.Random(9600)
    sent, line = [], bytearray()
    for number in range(20_000):
        body = bytes((rng.randrange(1, 256), 0x06, *rng.randbytes(rng.choice((0, 4, 11)))))
        frame = encode_frame(body, ONCE)
        kind = rng.random()
        if kind < 0.1:
            cut = rng.randrange(len(frame))
            line += frame[:cut] + frame[cut + 1 :] if kind < 0.05 else frame[:cut]
        else:
            sent.append(body)
            line += frame
        if number % 7 == 0:
            line += rng.randbytes(rng.randrange(4))
    received = bodies_in(bytes(line))
    assert received == reference_frames(bytes(line))
    lost = len(sent) - sum(_in_order(sent, received))
    assert lost <= 2


def _in_order(sent: list[bytes], received: list[bytes]) -> list[bool]:
    """For each frame sent, whether it was received, in order."""
    at, found = 0, []
    for body in sent:
        try:
            at = received.index(body, at, at + 50) + 1
        except ValueError:
            found.append(False)
        else:
            found.append(True)
    return found
