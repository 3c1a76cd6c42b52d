"""The pipes between the server and its OPC UA process: one has the live state, the other the status. Pure.

The process gets the same updates of the live state as every follower, first those that make up the complete
state of a bus, and applies the same rules to them. Its messages only change what is shown about it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from app.line.conditions.condition import AlarmPriority
from app.line.live.bus_live import BusLive
from bus.contract import BusFigures, BusLink, ParameterValue, Reading, UnitLink, Update
from bus.instants import UnixTime
from bus.messages import Message

MAX_FRAME = 16_000_000
_FOLLOWED = (Reading, ParameterValue, UnitLink, BusLink)
T = TypeVar("T")


class _Tagged(msgspec.Struct, frozen=True, tag_field="is"):
    """A message over a pipe."""


class Begin(_Tagged, frozen=True, tag="begin"):
    """The first message to the process, with its settings. ``folder``: of the certificates; ``names``: of
    this machine, for its certificate; ``buses``: the settings of each bus, as JSON."""

    site: str
    version: str
    host: str
    port: int
    folder: str
    names: list[str]
    manufacturer: str
    serial_number: str
    buses: list[str]


class Changes(_Tagged, frozen=True, tag="changes"):
    """A message with the updates of a bus worker."""

    bus: str
    updates: list[Reading | ParameterValue | UnitLink | BusLink | BusFigures]


class StandingAlarm(msgspec.Struct, frozen=True, array_like=True):
    """An alarm that is active or unacknowledged and not hidden. ``since``: the time when it came."""

    name: str
    priority: AlarmPriority
    is_active: bool
    is_acknowledged: bool
    since: UnixTime


class UnitAlarms(_Tagged, frozen=True, tag="alarms"):
    """A message with the standing alarms of units of a bus, the most important first."""

    bus: str
    of_units: dict[int, list[StandingAlarm]]


class Key(_Tagged, frozen=True, tag="key"):
    """A token with which a program may sign in: its id, its name and the hash of its secret."""

    id: int
    name: str
    hash: bytes
    expires_at: UnixTime | None


class Keys(_Tagged, frozen=True, tag="keys"):
    """The tokens with which programs may sign in."""

    keys: list[Key]


class Status(_Tagged, frozen=True, tag="status"):
    """The status of the process, sent once a second. ``refused``: connections, sessions and requests that it
    refused since its start; ``waiting``: clients' certificates that wait to be trusted; ``accounts``: the ids
    of the tokens of its sessions; ``fault``: why it does not serve."""

    is_serving: bool = False
    sessions: int = 0
    subscriptions: int = 0
    refused: int = 0
    waiting: int = 0
    cpu_s: float = 0.0
    memory_bytes: int = 0
    certificate_ends: UnixTime | None = None
    accounts: Annotated[list[int], Meta(max_length=1000)] = []
    fault: Message | None = None


ToProcess = Begin | Changes | UnitAlarms | Keys
_encoder = msgspec.msgpack.Encoder()
to_process: msgspec.msgpack.Decoder[ToProcess] = msgspec.msgpack.Decoder(ToProcess)
from_process: msgspec.msgpack.Decoder[Status] = msgspec.msgpack.Decoder(Status)


def frame(message: ToProcess | Status) -> bytes:
    """Return a message as sent over a pipe: its length in four bytes, then the message."""
    data = _encoder.encode(message)
    return len(data).to_bytes(4, "big") + data


class Frames:
    """A decoder that splits the bytes of a pipe into messages."""

    def __init__(self, decoder: msgspec.msgpack.Decoder[Any]) -> None:
        self._decoder = decoder
        self._data = bytearray()

    def feed(self, data: bytes) -> Iterator[Any]:
        """Yield the complete messages. Raise ValueError for other bytes."""
        self._data += data
        while len(self._data) >= 4:
            size = int.from_bytes(self._data[:4], "big")
            if size > MAX_FRAME:
                raise ValueError("a message over the pipe is too long")
            if len(self._data) < 4 + size:
                return
            message = bytes(self._data[4 : 4 + size])
            del self._data[: 4 + size]
            yield self._decoder.decode(message)


def followed(updates: Iterable[Update]) -> list[Any]:
    """Return the updates that the process needs; of a bus's figures only the duration of a scan."""
    found: list[Any] = []
    for update in updates:
        if isinstance(update, BusFigures):
            found.append(BusFigures(update.at, update.scan_hz, update.scan_s, update.wire_utilisation, 0.0))
        elif isinstance(update, _FOLLOWED):
            found.append(update)
    return found


def state_of(bus: BusLive) -> Changes:
    """Return the updates that make up the present state of a bus."""
    updates: list[Any] = [bus.link]
    for unit in bus.units.values():
        updates += [unit.link, *unit.parameters.values()]
        if unit.reading is not None:
            updates.append(unit.reading)
    if bus.figures is not None:
        updates.append(bus.figures)
    return Changes(bus.settings.name, followed(updates))
