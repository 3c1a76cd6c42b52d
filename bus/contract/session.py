"""The messages that open and carry a session between worker and app, and the offset of their clocks."""

from __future__ import annotations

from math import inf
from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta, field

from bus.contract.actions import (
    MAX_UNITS,
    MAX_UPDATES,
    Action,
    ClockDifference,
    Id,
    LongText,
    ShortText,
    Stamp,
    TaggedStruct,
    Total,
    UnitId,
    UnitScale,
)
from bus.contract.updates import BusFigures, BusLink, UnitState, Update
from bus.instants import UnixTime


class Hello(TaggedStruct, frozen=True, tag="hello"):
    """First message of a worker. ``worker`` is new at every start, so sequence numbers belong to it."""

    version: int
    bus: ShortText
    worker: Id
    started_at: Stamp
    software: ShortText
    port: LongText
    sent_at: Stamp


class Snapshot(TaggedStruct, frozen=True, tag="snapshot"):
    """The complete present state; ``seq`` is the number of the last update it includes. ``app_behind_s``: the
    most that the app's clock can be behind the worker's, by the promptest message of the app; None from a
    worker of an older release."""

    seq: Total
    sent_at: Stamp
    bus: BusLink
    units: Annotated[list[UnitState], Meta(max_length=MAX_UNITS)]
    figures: BusFigures | None = None
    app_behind_s: ClockDifference | None = None


class Batch(TaggedStruct, frozen=True, tag="batch"):
    """Updates in order. ``live`` False: kept while the app was away, so they belong to history only.
    ``app_behind_s``: as in Snapshot."""

    seq: Total
    sent_at: Stamp
    updates: Annotated[list[Update], Meta(max_length=MAX_UPDATES)]
    live: bool = True
    app_behind_s: ClockDifference | None = None


WorkerMessage = Hello | Snapshot | Batch


class Command(TaggedStruct, frozen=True, tag="command"):
    """An action with an id and a deadline. ``deadline``: on the app's clock (which the worker knows by
    ``ClockSync``), the last instant at which a frame that writes may leave. A worker carries out an id once;
    a second request with it returns the same result.

    ``scales``: by unit, the parameters with which its value was converted. They are read again with the
    read-back and, if a person ``typed`` the value as the unit shows it, also before the write, which is
    refused if they differ.
    """

    id: Id
    deadline: Stamp
    action: Action
    scales: Annotated[dict[UnitId, UnitScale], Meta(max_length=MAX_UNITS)] = field(default_factory=dict)
    typed: bool = False


class ReserveTurn(TaggedStruct, frozen=True, tag="reserve"):
    """A note that a write is about to be requested: keep the next turn of the wire free for a moment."""


class Cancel(TaggedStruct, frozen=True, tag="cancel"):
    """A request to end a command at the next point where nothing is half done."""

    id: Id


class Welcome(TaggedStruct, frozen=True, tag="welcome"):
    """The app's response to Hello. ``seq``: the last batch it has of this very worker (0: none). ``refused``:
    why the app refuses this worker; empty if it does not. ``held``: the units that may hold a staged speed of
    an earlier worker."""

    version: int
    seq: Total
    app_time: Stamp
    refused: LongText = ""
    held: Annotated[list[UnitId], Meta(max_length=MAX_UNITS)] = field(default_factory=list)


class Delivered(TaggedStruct, frozen=True, tag="delivered"):
    """A note that the app has everything up to ``seq``; the worker may forget it."""

    seq: Total


class ClockSync(TaggedStruct, frozen=True, tag="clock"):
    """The app's time, about once a second: the worker keeps the least delay it has seen, so that it
    recognizes a command that was held up on the way."""

    app_time: Stamp


class Watch(TaggedStruct, frozen=True, tag="watch"):
    """The units on a page that someone has open, and whether someone follows the trace."""

    units: Annotated[list[UnitId], Meta(max_length=MAX_UNITS)]
    trace: bool = False


class WantSnapshot(TaggedStruct, frozen=True, tag="want_snapshot"):
    """A request for a complete snapshot, because a number was missing."""


AppMessage = Welcome | Delivered | ClockSync | Watch | WantSnapshot | ReserveTurn | Command | Cancel

M = TypeVar("M")


class MalformedMessageError(Exception):
    """Raised for data that is no message of the other side. The text may quote the data: for a log only."""


_encoder = msgspec.msgpack.Encoder()
_worker_decoder: msgspec.msgpack.Decoder[WorkerMessage] = msgspec.msgpack.Decoder(WorkerMessage)
_app_decoder: msgspec.msgpack.Decoder[AppMessage] = msgspec.msgpack.Decoder(AppMessage)


def encode(message: WorkerMessage | AppMessage) -> bytes:
    """Encode a message as one binary WebSocket message."""
    return _encoder.encode(message)


def decode_from_worker(data: bytes) -> WorkerMessage:
    """Decode a worker's message. Raise MalformedMessageError if it is not valid, or outside the bounds."""
    return _decoded(_worker_decoder, data)


def decode_from_app(data: bytes) -> AppMessage:
    """Decode a message of the app. Raise MalformedMessageError if it is not valid, or outside the bounds."""
    return _decoded(_app_decoder, data)


def _decoded(decoder: msgspec.msgpack.Decoder[M], data: bytes) -> M:
    try:
        return decoder.decode(data)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        # Text that is not UTF-8 raises ValueError, endlessly nested arrays RecursionError.
        raise MalformedMessageError(str(error)) from error


WINDOW_S = 10.0


class ClockOffset:
    """An estimate of the offset to add to the other machine's times, from messages that carry their time of
    sending.

    A message arrives later than it was sent, never earlier, so the least difference between the two clocks is
    the best estimate (the clock filter of NTP, RFC 5905, 10). The least is taken over a time on *this* side's
    clock, not over a count of messages: after a stall many arrive at once, all late, and they must not
    displace the good samples. A clock that was set ahead is therefore followed at once, and one that was set
    back after two windows. Times are seconds since the epoch.
    """

    def __init__(self) -> None:
        self._window_began = UnixTime(-inf)
        self._least = inf
        self._least_before = inf

    def observe(self, sent_at: UnixTime, received_at: UnixTime) -> None:
        """Add the sample of one message. ``sent_at`` is of the other clock, ``received_at`` of this one."""
        if not 0 <= received_at - self._window_began <= WINDOW_S:
            self._window_began = received_at
            self._least_before, self._least = self._least, inf
        self._least = min(self._least, received_at - sent_at)

    @property
    def seconds(self) -> float | None:
        """The estimate in seconds; None before the first message."""
        least = min(self._least, self._least_before)
        return None if least == inf else least

    def here(self, time: UnixTime) -> UnixTime:
        """Return the moment ``time`` of the other clock on this one; unchanged before the first message."""
        return time + (self.seconds or 0.0)
