"""The UART's timetable and the simulated line, and each of its faults, on the test's clock."""

from __future__ import annotations

import itertools
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.catalogue import parameters as numbers
from bus.settings import Dialect, wire_seconds
from bus.simulator.line import HUGE_BYTES, FaultKind, Faults, Piece, SimulatedLine, WireEventKind, WireRecord
from bus.simulator.plant import demo_line
from bus.simulator.ports import WAKE_S, ReplyLine, RequestLine
from bus.simulator.unit import ORDINARY, Mode, Traits
from bus.wire.commands import (
    ReadStatusRequest,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    WriteParameterRequest,
    encode_request,
)
from bus.wire.framing import FrameDecoder, Noise, ReceivedFrame, encode_frame

PLAIN = Dialect()
BYTE_S = 10 / 9600


class Host:
    """Writes requests and keeps what comes, with times; the clock moves from wake to wake."""

    def __init__(self, line: SimulatedLine, baud: int | None = 9600) -> None:
        self.line, self.baud = line, baud
        self.now = 100.0
        line.advance(self.now)
        self.got: list[tuple[float, bytes]] = []

    def write(self, *requests: Request) -> None:
        self.line.receive(self.now, b"".join(encode_request(each, PLAIN) for each in requests), self.baud)

    def wait(self, seconds: float) -> None:
        until = self.now + seconds
        while (wake := self.line.wake()).at <= until:
            self.now = wake.at
            if data := self.line.advance(self.now):
                self.got.append((self.now, data))
        self.now = until

    @property
    def data(self) -> bytes:
        return b"".join(data for _, data in self.got)

    def bodies(self) -> list[bytes]:
        events = FrameDecoder(PLAIN).feed(self.data)
        return [event.body for event in events if isinstance(event, ReceivedFrame)]

    def exchange(self, *requests: Request, seconds: float = 1.0) -> list[bytes]:
        self.got.clear()
        self.write(*requests)
        self.wait(seconds)
        return self.bodies()


def host(units: int = 3, *, traits: Traits = ORDINARY, speedup: float = 1.0, seed: int = 1) -> Host:
    plant = demo_line(units, seed=seed, traits=traits, script=False).plant
    return Host(SimulatedLine(plant, Faults(seed), speedup=speedup))


# --- the timetable --------------------------------------------------------------------------------


@given(
    st.lists(st.tuples(st.floats(0, 0.05), st.integers(1, 20)), min_size=1, max_size=20),
    st.sampled_from([300, 1200, 9600]),
)
def test_request_bytes_arrive_at_baud_pace_and_never_overtake(
    writes: list[tuple[float, int]], baud: int
) -> None:
    line, byte_s, now = RequestLine(), wire_seconds(1, baud), 0.0
    arrivals: list[float] = []
    for pause, count in writes:
        now += pause
        times = line.carry(now, count, byte_s)
        assert times[0] >= now + byte_s * 0.999999
        arrivals += times
    gaps = [after - before for before, after in itertools.pairwise(arrivals)]
    assert all(gap >= byte_s * 0.999999 for gap in gaps)


@given(st.binary(min_size=1, max_size=40), st.floats(0, 10), st.sampled_from([300, 9600]))
def test_no_reply_byte_comes_before_its_time_and_all_come(data: bytes, at: float, baud: int) -> None:
    line, byte_s = ReplyLine(), wire_seconds(1, baud)
    assert line.transmit(1, at, data, byte_s) == pytest.approx(at + len(data) * byte_s)
    got = b""
    while wake := line.wake():
        got += line.due(wake.at)
        complete = int((wake.at - at) / byte_s + 1e-6)
        assert len(got) <= complete
        assert len(got) >= complete - WAKE_S / byte_s - 1
    assert got == data


# --- the line -------------------------------------------------------------------------------------


def test_lateness_does_not_add_up_over_a_thousand_exchanges() -> None:
    """Requests queued at once each get a response one request time apart, however the clock was read."""
    there = host()
    began = there.now
    there.exchange(*[ReadStatusRequest(1)] * 50, seconds=3.0)
    sent = list(there.line.record.since(0, WireEventKind.SENT))
    assert len(sent) == 50
    total = sum(len(entry.data) for entry in sent)
    assert sent[-1].at - began == pytest.approx(7 * BYTE_S + total * BYTE_S)
    assert there.got[-1][0] >= sent[-1].at


# --- faults on the line ---------------------------------------------------------------------------


def test_a_late_response_comes_before_any_later_response_of_that_unit() -> None:
    there = host()
    there.line.faults.set(FaultKind.LATE, 1.0, unit=1)
    there.write(ReadStatusRequest(1))
    there.wait(0.1)
    assert there.data == b""
    there.line.faults.clear()
    assert [len(body) for body in there.exchange(WriteParameterRequest(1, 6, 50))] == [13, 2]


# --- the record and the seed ----------------------------------------------------------------------


def test_the_record_has_requests_actions_responses_and_bytes() -> None:
    there = host()
    there.line.plant.unit(2).memory[numbers.CONTROL_MODE] = Mode.LOCAL
    there.exchange(SetAndExecuteSpeedRequest(1, 500), SetAndExecuteSpeedRequest(2, 500), ReadStatusRequest(9))
    entries = [(entry.what, entry.unit) for entry in there.line.record.since()]
    assert entries[0] == (WireEventKind.CAME, 0)
    assert [entry for entry in entries if entry[0] is WireEventKind.RECEIVED] == [
        (WireEventKind.RECEIVED, unit) for unit in (1, 2, 0)
    ]
    assert [entry for entry in entries if entry[0] is WireEventKind.ACTED] == [(WireEventKind.ACTED, 1)]
    responses = {entry.unit: entry.data for entry in there.line.record.since(0, WireEventKind.RESPONDED)}
    assert responses == {1: bytes((1, 6)), 2: bytes((2, 0x15, 0x80))}
    counted = [entry.number for entry in there.line.record.since()]
    assert counted == list(range(1, there.line.record.count + 1))
    assert list(there.line.record.since(there.line.record.count)) == []


def test_the_same_seed_gives_the_same_bytes_at_the_same_times() -> None:
    def course(seed: int) -> list[tuple[float, bytes]]:
        there = host(4, seed=seed, traits=Traits(turnaround_s=0.003))
        for kind in FaultKind:
            there.line.faults.set(kind, 0.05)
        for round_ in range(12):
            there.write(ReadStatusRequest(round_ % 4 + 1), StageSpeedRequest(round_ % 4 + 1, round_))
            there.wait(0.2)
        return there.got

    assert course(1) == course(1)
    assert course(1) != course(2)


@given(st.floats(0, 1e6))
def test_work_due_at_a_wake_is_done_at_it(start: float) -> None:
    """With any rounding of times, a wake that was met is not requested a second time."""
    line = SimulatedLine(demo_line(1, script=False).plant)
    line.advance(start)
    wake = line.wake()
    for _ in range(20):
        line.advance(wake.at)
        assert line.wake().at > wake.at
        wake = line.wake()


def test_the_record_is_bounded_and_its_numbers_go_on() -> None:
    record = WireRecord(deque(maxlen=5))
    for moment in range(12):
        record.add(float(moment), WireEventKind.CAME, 0, b"")
    assert [entry.number for entry in record.since()] == [8, 9, 10, 11, 12]
    assert [entry.number for entry in record.since(10)] == [11, 12]
    assert list(record.since(12)) == list(WireRecord().since()) == []


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
