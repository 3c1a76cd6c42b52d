"""A complete simulated line without a port: bytes and times in, bytes and times out.

One clock, passed in, drives everything: request bytes on their way, responses, physics, faults.
``bus.simulator.serve`` gives it a real clock and a port; a test gives it a virtual one, and the same seed
gives the same bytes. Tests judge a host by the record of what the line received, did and sent. A fault
belongs to one unit (by its address) or, under address 0, to every unit of the line.
"""

from __future__ import annotations

import math
import random
from collections import defaultdict, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal, NamedTuple

from bus.errors import UnitErrorCode
from bus.settings import Dialect, wire_seconds
from bus.simulator.plant import STEP_S, Plant
from bus.simulator.ports import ReplyLine, RequestLine, Wake
from bus.simulator.unit import ALL_UNITS, Turn, Unit, respond
from bus.wire.commands import TRAITS, Nak, reply_body
from bus.wire.framing import ACK, DLE, FrameDecoder, ReceivedFrame, checksum, encode_frame

MAX_RECORD = 200_000
"""The most entries kept; the oldest go first."""


class WireEventKind(StrEnum):
    """The kinds of entry in the record of a line."""

    CAME = "came"
    """The bytes that the host wrote, at the time it wrote them."""
    RECEIVED = "received"
    """A complete request reached a unit ``at`` its last byte. Unit 0: no unit has its address."""
    ACTED = "acted"
    """The unit carried out the write in ``data``."""
    RESPONDED = "responded"
    """The unit's response, before any fault."""
    SENT = "sent"
    """The bytes sent to the host, faults included; ``at`` is when the last of them is out."""


@dataclass(frozen=True, slots=True)
class WireEvent:
    """An entry of the record. ``number`` counts from 1; ``at`` is on the line's clock; ``data`` is a body for
    RECEIVED, ACTED and RESPONDED (the bytes between STX and DLE ETX), else bytes as on the wire."""

    number: int
    at: float
    what: WireEventKind
    unit: int
    data: bytes


@dataclass
class WireRecord:
    """The record of a line, bounded, in the order of events."""

    _entries: deque[WireEvent] = field(default_factory=lambda: deque(maxlen=MAX_RECORD))
    count: int = 0

    def add(self, at: float, what: WireEventKind, unit: int, data: bytes) -> None:
        self.count += 1
        self._entries.append(WireEvent(self.count, at, what, unit, data))

    def since(self, number: int = 0, *what: WireEventKind) -> Iterator[WireEvent]:
        """Return the entries after ``number`` of the kinds ``what`` (default all); other threads may call
        this."""
        entries = tuple(self._entries)  # The interpreter makes this copy in one step.
        known = number - entries[0].number + 1 if entries else 0
        return (entry for entry in entries[max(known, 0) :] if not what or entry.what in what)


EVERY_UNIT = 0
LATE_S = 0.4
"""A delay in seconds beyond any timeout of a host with the default turnaround of 50 ms."""
SLOW_S = 0.03
"""A delay in seconds that is longer than usual, yet within the default turnaround."""
HUGE_BYTES = 10_000


class FaultKind(StrEnum):
    """The faults. DEAD to FLOOD act when a request arrives, the others on the response."""

    DEAD = "dead"
    """The request is not received: power off, or the drop cut."""
    NAK = "nak"
    """The unit refuses and does not act."""
    ALL_ADDRESSES = "all_addresses"
    """The unit takes every address for its own."""
    ECHO = "echo"
    """Line only: the adapter returns the host's bytes to it."""
    FLOOD = "flood"
    """Line only: endless bytes that never form a frame, as long as the rate is not 0."""

    LATE = "late"
    SLOW = "slow"
    LOST = "lost"
    DOUBLED = "doubled"
    FOREIGN = "foreign"
    """The response carries another unit's address."""
    CUT = "cut"
    CORRUPT = "corrupt"
    NOISE = "noise"
    """Noise before or after the response."""
    WRONG_LENGTH = "wrong_length"
    """A complete frame with a right checksum whose data fits no command's response."""
    HUGE = "huge"
    """A frame of 10,000 bytes."""


class Piece(NamedTuple):
    """The bytes that a unit sends ``delay`` seconds later than a good response would begin."""

    delay: float
    data: bytes


@dataclass
class Faults:
    """The present rates of faults on one line; every draw comes from its ``seed``."""

    seed: int = 0
    late_s: float = LATE_S
    foreign_address: int = 0
    """The address that FOREIGN responses carry; 0 for that of the next unit."""
    _rates: dict[int, dict[FaultKind, float]] = field(default_factory=lambda: defaultdict(dict))
    _random: random.Random = field(init=False)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def set(self, kind: FaultKind, rate: float, unit: int = EVERY_UNIT) -> None:
        """Set the ``rate`` of ``kind`` (0 never, 1 always) for ``unit`` or for every unit."""
        if rate:
            self._rates[unit][kind] = rate
        else:
            self._rates[unit].pop(kind, None)

    def clear(self) -> None:
        self._rates.clear()

    def strikes(self, kind: FaultKind, unit: int = EVERY_UNIT) -> bool:
        """Return whether ``kind`` happens now. A rate of 0 draws no random number, so that it disturbs no
        seed."""
        rate = max(self._rates[EVERY_UNIT].get(kind, 0.0), self._rates[unit].get(kind, 0.0))
        return rate > 0 and self._random.random() < rate

    def refusal(self, command: int) -> int:
        """Return the code of an unfounded NAK: one of those that the manual lists for ``command``."""
        listed = sorted(TRAITS[command].refusals) if command in TRAITS else []
        return self._random.choice([*listed, UnitErrorCode.ILLEGAL_COMMAND])

    def noise_bytes(self, count: int) -> bytes:
        """Return ``count`` bytes without a frame in them: no 10h, so nothing ever starts or ends."""
        return bytes(self._random.choice(_NO_DLE) for _ in range(count))

    def spoil(self, unit: int, frame: bytes, body: bytes) -> list[Piece]:
        """Apply the first fault that strikes to a response: ``frame`` as the unit wrote it, ``body`` its
        content."""
        kind = next((kind for kind in _ON_RESPONSES if self.strikes(kind, unit)), None)
        match kind:
            case FaultKind.LATE:
                return [Piece(self.late_s * self._random.uniform(0.5, 1.5), frame)]
            case FaultKind.SLOW:
                return [Piece(SLOW_S, frame)]
            case FaultKind.LOST:
                return []
            case FaultKind.DOUBLED:
                return [Piece(0.0, frame), Piece(0.0, frame)]
            case None:
                return [Piece(0.0, frame)]
        return [Piece(0.0, self._spoilt(kind, frame, body))]

    def _spoilt(self, kind: FaultKind, frame: bytes, body: bytes) -> bytes:
        match kind:
            case FaultKind.FOREIGN:
                other = self.foreign_address or body[0] % 255 + 1
                return encode_frame(bytes((other,)) + body[1:], _PLAIN)
            case FaultKind.CUT:
                return frame[: self._random.randrange(1, len(frame))]
            case FaultKind.CORRUPT:
                spoilt = bytearray(frame)
                spoilt[self._random.randrange(len(frame))] ^= self._random.randrange(1, 256)
                return bytes(spoilt)
            case FaultKind.NOISE:
                noise = self.noise_bytes(self._random.randrange(1, 12))
                return self._random.choice((noise + frame, frame + noise))
            case FaultKind.WRONG_LENGTH:
                length = self._random.choice((3, 5, 7, 9))
                odd = bytes(self._random.randrange(256) for _ in range(length))
                return encode_frame(bytes((body[0], ACK)) + odd, _PLAIN)
        huge = bytes((body[0], ACK)) + self.noise_bytes(HUGE_BYTES)
        return b"\x10\x02" + huge + b"\x10\x03" + bytes((checksum(huge),))


_PLAIN = Dialect()
_NO_DLE = bytes(value for value in range(256) if value != 0x10)
_ON_RESPONSES = tuple(FaultKind)[tuple(FaultKind).index(FaultKind.LATE) :]


IDLE_S = 1.5 * STEP_S
"""The seconds that the physics may lag while no request comes."""

FLOOD_TALKER = -1
ECHO_TALKER = -2
"""Senders on the reply pair that are no unit; units are numbered by their place in the plant."""


class _Arriving(NamedTuple):
    """A request on its way. ``checksum_10h``: only units with this setting accept such a checksum."""

    at: float
    body: bytes
    baud: int | None
    checksum_10h: Literal["once", "twice"] | None = None


@dataclass
class SimulatedLine:
    """The simulated plant and its cable. ``baud`` is the pace while the host's own speed cannot be known.
    ``speedup`` shortens byte times and turnarounds, not the physics. The power comes on with the first
    ``advance``."""

    plant: Plant
    faults: Faults = field(default_factory=Faults)
    baud: int = 9600
    speedup: float = 1.0
    record: WireRecord = field(default_factory=WireRecord)

    def __post_init__(self) -> None:
        self._requests = RequestLine()
        self._replies = ReplyLine()
        self._decoder = FrameDecoder(Dialect())
        self._arriving: deque[_Arriving] = deque()
        self._partial: _Arriving | None = None
        self._physics_at = math.inf

    def receive(self, now: float, data: bytes, host_baud: int | None = None) -> None:
        """Take ``data`` that the host wrote at ``now``, its port set to ``host_baud`` (None: unknown)."""
        self.record.add(now, WireEventKind.CAME, EVERY_UNIT, data)
        byte_s = self._byte_s(host_baud)
        for at, value in zip(self._requests.carry(now, len(data), byte_s), data, strict=True):
            if self.faults.strikes(FaultKind.ECHO):
                self._replies.transmit(ECHO_TALKER, at - byte_s, bytes((value,)), byte_s)
            self._receive_second_10h(at, value, byte_s)
            for event in self._decoder.feed(bytes((value,))):
                if isinstance(event, ReceivedFrame):
                    arriving = _Arriving(at, event.body, host_baud)
                    if event.wire[-1] == DLE:
                        self._partial = arriving = arriving._replace(checksum_10h="once")
                    self._arriving.append(arriving)

    def advance(self, now: float) -> bytes:
        """Let everything happen that is due by ``now``; return the bytes that reach the host by then."""
        if self._physics_at == math.inf:
            self._physics_at = now + STEP_S
        while self._arriving and self._arriving[0].at <= now:
            arriving = self._arriving.popleft()
            self._step_physics(arriving.at, behind=0.0)
            self._dispatch(arriving)
        self._step_physics(now, behind=IDLE_S)
        return self._replies.due(now)

    def wake(self) -> Wake:
        """Return when ``advance`` is due next, if the host sends nothing."""
        reply = self._replies.wake()
        idle = self._physics_at + IDLE_S
        inside = Wake(min(self._arriving[0].at, idle) if self._arriving else idle, sharp=False)
        return inside if reply is None else min(inside, reply)

    def unplug(self) -> None:
        """Pull the cable: nothing that is under way arrives."""
        self._arriving.clear()
        self._partial = None
        self._replies.clear()
        self._decoder = FrameDecoder(Dialect())

    def _receive_second_10h(self, at: float, value: int, byte_s: float) -> None:
        """Give a unit that waits for a second 10h its frame if that follows at once."""
        half, self._partial = self._partial, None
        if half is not None and value == DLE and at - half.at < 2 * byte_s:
            self._arriving.append(half._replace(at=at, checksum_10h="twice"))

    def _step_physics(self, now: float, behind: float) -> None:
        """Step up to ``behind`` before ``now``; best after a request, as its response leaves time."""
        while self._physics_at + behind <= now:
            self.plant.step(STEP_S)
            if self.faults.strikes(FaultKind.FLOOD):
                byte_s = self._byte_s(None)
                noise = self.faults.noise_bytes(int(STEP_S / byte_s))
                self._send(FLOOD_TALKER, self._physics_at, noise, byte_s)
            self._physics_at += STEP_S

    def _dispatch(self, arriving: _Arriving) -> None:
        received = False
        for place, unit in enumerate(self.plant.units):
            if self._receives(unit, arriving):
                received = True
                self._respond(place, unit, arriving)
        if not received:
            self.record.add(arriving.at, WireEventKind.RECEIVED, EVERY_UNIT, arriving.body)

    def _receives(self, unit: Unit, arriving: _Arriving) -> bool:
        if arriving.baud is not None and arriving.baud != unit.baud:
            return False
        if arriving.checksum_10h not in (None, unit.traits.dialect.checksum_10h):
            return False
        address = arriving.body[0]
        if address not in (ALL_UNITS, unit.address) and not self.faults.strikes(
            FaultKind.ALL_ADDRESSES, unit.address
        ):
            return False
        return not self.faults.strikes(FaultKind.DEAD, unit.address)

    def _respond(self, place: int, unit: Unit, arriving: _Arriving) -> None:
        address, at = unit.address, arriving.at
        byte_s = self._byte_s(arriving.baud)
        self.record.add(at, WireEventKind.RECEIVED, address, arriving.body)
        if arriving.body[0] != ALL_UNITS and self.faults.strikes(FaultKind.NAK, address):
            refusal = self.faults.refusal(arriving.body[1])
            turn = Turn(Nak(arriving.body[0], refusal), acted=False)
        else:
            turn = respond(unit, arriving.body)
        if turn.acted:
            self.record.add(at, WireEventKind.ACTED, address, arriving.body)
        if turn.reply is None:
            return
        body = reply_body(turn.reply, unit.traits.dialect)
        frame = encode_frame(body, unit.traits.dialect)
        begins = at + unit.turnaround() / self.speedup
        self.record.add(begins, WireEventKind.RESPONDED, address, body)
        for piece in self.faults.spoil(address, frame, body):
            self._send(place, begins + piece.delay, piece.data, byte_s)

    def _send(self, talker: int, at: float, data: bytes, byte_s: float) -> None:
        ends = self._replies.transmit(talker, at, data, byte_s)
        self.record.add(ends, WireEventKind.SENT, EVERY_UNIT, data)

    def _byte_s(self, host_baud: int | None) -> float:
        return wire_seconds(1, host_baud or self.baud) / self.speedup
