"""Each fault changes a response as its name states, as often as its rate states, by its seed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.settings import Dialect
from bus.simulator.line import HUGE_BYTES, FaultKind, Faults, Piece
from bus.wire.framing import FrameDecoder, Noise, ReceivedFrame, encode_frame

BODY = bytes.fromhex("04 06 00 00 04 B0 00 00 04 AF 80 C0 43")
FRAME = encode_frame(BODY, Dialect())
seeds = st.integers(0, 2**32)


def spoilt(kind: FaultKind, seed: int) -> list[Piece]:
    faults = Faults(seed)
    faults.set(kind, 1.0)
    return faults.spoil(4, FRAME, BODY)


def frames_in(data: bytes) -> list[bytes]:
    decoder = FrameDecoder(Dialect())
    return [
        event.body for event in (*decoder.feed(data), *decoder.flush()) if isinstance(event, ReceivedFrame)
    ]


def received(pieces: list[Piece]) -> list[bytes]:
    return frames_in(b"".join(piece.data for piece in pieces))


def test_without_a_fault_a_response_is_unchanged() -> None:
    assert Faults().spoil(4, FRAME, BODY) == [Piece(0.0, FRAME)]


@given(seeds)
def test_lost(seed: int) -> None:
    assert spoilt(FaultKind.LOST, seed) == []


@given(seeds)
def test_late_and_slow_are_complete_responses_after_their_time(seed: int) -> None:
    [late], [slow] = spoilt(FaultKind.LATE, seed), spoilt(FaultKind.SLOW, seed)
    assert late.data == slow.data == FRAME
    assert slow.delay < 0.05 < late.delay


@given(seeds)
def test_doubled(seed: int) -> None:
    assert received(spoilt(FaultKind.DOUBLED, seed)) == [BODY, BODY]


@given(seeds)
def test_foreign_is_a_good_frame_of_another_unit(seed: int) -> None:
    [body] = received(spoilt(FaultKind.FOREIGN, seed))
    assert body[0] != BODY[0]
    assert body[1:] == BODY[1:]


@given(seeds)
def test_cut_and_corrupt_are_never_taken_for_a_response(seed: int) -> None:
    for kind in (FaultKind.CUT, FaultKind.CORRUPT):
        [piece] = spoilt(kind, seed)
        assert piece.data != FRAME
        assert received([piece]) == []


@given(seeds)
def test_noise_leaves_the_response_beside_it_intact(seed: int) -> None:
    [piece] = spoilt(FaultKind.NOISE, seed)
    assert len(piece.data) > len(FRAME)
    assert received([piece]) == [BODY]


@given(seeds)
def test_wrong_length_is_a_good_frame_that_fits_no_request(seed: int) -> None:
    [body] = received(spoilt(FaultKind.WRONG_LENGTH, seed))
    assert len(body) - 2 not in (0, 1, 2, 4, 11)


@given(seeds)
def test_huge_is_ten_thousand_bytes_that_hold_no_frame(seed: int) -> None:
    [piece] = spoilt(FaultKind.HUGE, seed)
    assert len(piece.data) > HUGE_BYTES
    assert received([piece]) == []


@given(seeds, st.integers(1, 3000))
def test_noise_never_frames(seed: int, count: int) -> None:
    noise = Faults(seed).noise_bytes(count)
    events = FrameDecoder(Dialect()).feed(noise)
    assert len(noise) == count
    assert all(isinstance(event, Noise) for event in events)


@pytest.mark.parametrize("kind", FaultKind)
def test_a_rate_is_a_rate_and_belongs_to_its_unit(kind: FaultKind) -> None:
    faults = Faults(3)
    faults.set(kind, 0.05, unit=7)
    assert sum(faults.strikes(kind, 7) for _ in range(4000)) == pytest.approx(200, abs=60)
    assert not any(faults.strikes(kind, 8) for _ in range(1000))


def test_a_fault_of_the_line_affects_every_unit_until_cleared() -> None:
    faults = Faults()
    faults.set(FaultKind.LOST, 1.0)
    assert faults.strikes(FaultKind.LOST, 3)
    faults.set(FaultKind.LOST, 0.0)
    assert not faults.strikes(FaultKind.LOST, 3)
    faults.set(FaultKind.LATE, 1.0, unit=3)
    faults.clear()
    assert not faults.strikes(FaultKind.LATE, 3)


def test_the_same_seed_has_the_same_bad_luck() -> None:
    def luck(seed: int) -> list[list[Piece]]:
        faults = Faults(seed)
        for kind in FaultKind:
            faults.set(kind, 0.1)
        return [faults.spoil(4, FRAME, BODY) for _ in range(200)]

    assert luck(1) == luck(1)
    assert luck(1) != luck(2)


def test_a_foreign_response_can_carry_a_given_address() -> None:
    faults = Faults(foreign_address=99)
    faults.set(FaultKind.FOREIGN, 1.0)
    assert received(faults.spoil(4, FRAME, BODY)) == [b"\x63" + BODY[1:]]
