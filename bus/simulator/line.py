"""A complete simulated line without a port: bytes and times in, bytes and times out.

One clock, passed in, drives everything: request bytes on their way, responses, physics, faults. ``serve``
gives it a real clock and a port; a test gives it a virtual one, and the same seed gives the same bytes.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from bus.settings import Dialect, wire_seconds
from bus.simulator.faults import EVERY_UNIT, FaultKind, Faults
from bus.simulator.pacer import ReplyLine, RequestLine, Wake
from bus.simulator.plant import STEP_S, Plant
from bus.simulator.record import WireEventKind, WireRecord
from bus.simulator.responding import ALL_UNITS, Turn, respond
from bus.simulator.unit import Unit
from bus.wire.commands import Nak, reply_body
from bus.wire.framing import DLE, FrameDecoder, ReceivedFrame, encode_frame

IDLE_S = 1.5 * STEP_S
"""How far the physics may lag while no request comes."""

FLOOD_TALKER = -1
ECHO_TALKER = -2
"""Talkers on the reply pair that are no unit; units are numbered by their place in the plant."""


class _Arriving(NamedTuple):
    """A request on its way. ``checksum_10h``: only units with this setting accept such a checksum."""

    at: float
    body: bytes
    baud: int | None
    checksum_10h: Literal["once", "twice"] | None = None


@dataclass
class SimulatedLine:
    """Plant and cable. ``baud`` is the pace while the host's own speed cannot be known.

    ``speedup`` shortens byte times and turnarounds, not the physics.
    The power comes on with the first ``advance``.
    """

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
        """The host wrote ``data`` at ``now``, its port set to ``host_baud`` (None: not known)."""
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
        """Let everything happen that is due by ``now``; the bytes that reach the host with it."""
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
        """The cable is gone: nothing that is under way arrives."""
        self._arriving.clear()
        self._partial = None
        self._replies.clear()
        self._decoder = FrameDecoder(Dialect())

    def _receive_second_10h(self, at: float, value: int, byte_s: float) -> None:
        """A unit that waits for a second 10h has its frame when that follows at once."""
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
