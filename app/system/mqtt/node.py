"""A bus as a Sparkplug B edge node with its units as devices: its messages and their order. Pure.

The topics are those of Sparkplug 3.0, 4: ``spBv1.0/<group>/<type>/<node>[/<device>]``. A device is born when
its unit responds and dies when it does not, so that its values count as stale.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from app.line.history.series.runs import micros
from app.line.live.bus_live import BusLive, UnitLive, unit_link_now
from app.system.mqtt.payload import (
    Command,
    DataType,
    Metric,
    PayloadError,
    Value,
    commands_in,
    encode_birth,
    encode_payload,
    encode_value,
)
from app.system.mqtt.settings import Deadbands, identifier_of
from app.system.tags import (
    OF_READING,
    Scale,
    Tag,
    other_values,
    reading_values,
    scale_now,
    tags_of,
    unique_names,
)
from bus.contract import Reading, Update
from bus.instants import UnixTime

NAMESPACE = "spBv1.0"
LINES = "lineside/v1/lines"
"""The topic above the documents of lines, beside Sparkplug."""
REBIRTH = "Node Control/Rebirth"
REBIRTH_EVERY_S = 5.0
MAX_SEQ = 256
"""Sequence numbers count from 0 to 255 (Sparkplug 3.0, 6.4.5)."""
MAX_QUEUED = 20_000
"""The most readings that wait to be sent; with more, the connection counts as lost."""
HISTORICAL_METRICS = 300
"""The most historical metrics in one payload."""
_TYPES: Mapping[str, DataType] = {
    "number": DataType.DOUBLE,
    "integer": DataType.INT64,
    "bit": DataType.BOOLEAN,
    "text": DataType.STRING,
}
_BD_SEQ = Metric("bdSeq", DataType.INT64)
_REBIRTH = Metric(REBIRTH, DataType.BOOLEAN)


class Publication(NamedTuple):
    """A message to publish: its topic and its payload."""

    topic: str
    payload: bytes


@dataclass(slots=True)
class Device:
    """A unit as a Sparkplug device. ``first_alias``: of its first tag, the others follow; ``sent``: the
    values that were sent last, None while the device is dead; ``scale``: that of its birth."""

    name: str
    unit: UnitLive
    first_alias: int
    metrics: Sequence[Metric] = ()
    sent: list[Value] | None = None
    scale: Scale | None = None
    sent_until: UnixTime = UnixTime(0.0)
    """The time of the newest reading that was sent."""


@dataclass(eq=False, repr=False)
class EdgeNode:
    """The Sparkplug edge node of a bus. ``alarms_of``: the number of active alarms of a unit."""

    bus: BusLive
    group: str
    alarms_of: Callable[[int], int]
    deadbands: Deadbands = field(default_factory=Deadbands)
    seq: int = 0
    refused: int = 0
    """The number of refused commands: the node takes no command except for a rebirth."""
    devices: dict[int, Device] = field(default_factory=dict)
    _readings: list[Reading] = field(default_factory=list)
    _changed: set[int] = field(default_factory=set)
    _is_born: bool = False
    _rebirth_at: UnixTime = UnixTime(0.0)

    def __post_init__(self) -> None:
        names = unique_names(
            (number, identifier_of(unit.settings.name)) for number, unit in self.bus.units.items()
        )
        alias = 0
        for number, unit in self.bus.units.items():
            self.devices[number] = Device(names[number], unit, alias)
            alias += len(tags_of(unit, scale_now(self.bus, unit)))
        bands = (self.deadbands.actual, self.deadbands.commanded, self.deadbands.analog)
        self._thresholds = tuple(map(float, bands))

    # --- topics and commands ---

    @property
    def name(self) -> str:
        """The id of the Sparkplug edge node, which is the name of its bus."""
        return self.bus.settings.name

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """The topics of commands to this node and its devices."""
        return (self._topic("NCMD"), self._topic("DCMD", "+"))

    @property
    def document_topic(self) -> str:
        """The topic of the summary of the line."""
        return f"{LINES}/{self.group}/{self.name}"

    def take_command(self, topic: str, payload: bytes, now: UnixTime) -> list[Publication]:
        """Return the births that a command requests, at most every `REBIRTH_EVERY_S`; refuse and count any
        other command: without deadline and acknowledgement, it could move a machine late."""
        try:
            commands = commands_in(payload)
        except PayloadError:
            commands = []
        if topic == self._topic("NCMD") and commands and all(map(_is_rebirth, commands)):
            if now - self._rebirth_at < REBIRTH_EVERY_S or not self._is_born:
                return []
            self._rebirth_at = now
            return self.births(now)
        self.refused += 1
        return []

    def _topic(self, kind: str, device: str = "") -> str:
        return "/".join(filter(None, (NAMESPACE, self.group, kind, self.name, device)))

    # --- births and deaths ---

    def death(self, bd_seq: int, now: UnixTime) -> Publication:
        """Return the death of the node: the will of its connection, and its last message."""
        metric = encode_birth(_BD_SEQ, _ms(now), bd_seq)
        return Publication(self._topic("NDEATH"), encode_payload(_ms(now), [metric], None))

    def begin(self, bd_seq: int, now: UnixTime) -> list[Publication]:
        """Return the births of the node and of every unit that responds, after a connection."""
        self._bd_seq = bd_seq
        self._is_born = True
        return self.births(now)

    def end(self) -> None:
        """Mark all devices as dead, after the end of a connection."""
        self._is_born = False
        for device in self.devices.values():
            device.sent = None
        self._readings.clear()
        self._changed.clear()

    def births(self, now: UnixTime) -> list[Publication]:
        """Return the birth of the node with sequence number 0, and of each unit that responds."""
        self.seq = MAX_SEQ - 1
        metrics = [
            encode_birth(_BD_SEQ, _ms(now), self._bd_seq),
            encode_birth(_REBIRTH, _ms(now), value=False),
        ]
        found = [Publication(self._topic("NBIRTH"), encode_payload(_ms(now), metrics, self._next()))]
        self._readings.clear()
        self._changed.clear()
        for device in self.devices.values():
            device.sent = None
            if self._is_alive(device, now):
                found.append(self._birth(device, now))
        return found

    def _birth(self, device: Device, now: UnixTime) -> Publication:
        """Return the birth of a device with all its values."""
        unit, reading = device.unit, device.unit.reading
        assert reading is not None, "only a unit that responded is born"
        device.scale = scale = scale_now(self.bus, unit)
        tags = tags_of(unit, scale)
        device.metrics = [_metric(tag, device.first_alias + place) for place, tag in enumerate(tags)]
        device.sent = [*reading_values(self.bus, unit, reading, scale), *self._others(device, now)]
        device.sent_until = reading.at
        metrics = [
            encode_birth(metric, _ms(reading.at if place < OF_READING else now), value)
            for place, (metric, value) in enumerate(zip(device.metrics, device.sent, strict=True))
        ]
        payload = encode_payload(_ms(now), metrics, self._next())
        return Publication(self._topic("DBIRTH", device.name), payload)

    def _others(self, device: Device, now: UnixTime) -> tuple[Value, ...]:
        number = device.unit.settings.id
        return other_values(device.unit, unit_link_now(self.bus, device.unit, now), self.alarms_of(number))

    def _is_alive(self, device: Device, now: UnixTime) -> bool:
        return unit_link_now(self.bus, device.unit, now) == "online"

    def _next(self) -> int:
        self.seq = (self.seq + 1) % MAX_SEQ
        return self.seq

    # --- changes ---

    def note(self, updates: Sequence[Update]) -> None:
        """Note the worker's updates, to be sent with `changes`."""
        if not self._is_born:
            return
        for update in updates:
            if type(update) is Reading:
                if update.unit in self.devices:
                    self._readings.append(update)
            elif (unit := getattr(update, "unit", None)) in self.devices:
                self._changed.add(unit)

    def note_unit(self, unit: int) -> None:
        """Note that an alarm of a unit changed, to be sent with `changes`."""
        if self._is_born and unit in self.devices:
            self._changed.add(unit)

    @property
    def is_behind(self) -> bool:
        """Whether more readings wait than a working connection allows."""
        return len(self._readings) > MAX_QUEUED

    def changes(self, now: UnixTime) -> list[Publication]:
        """Return the births, deaths and changed values since the last call: one message for each unit."""
        readings: dict[int, list[Reading]] = {}
        for reading in self._readings:
            readings.setdefault(reading.unit, []).append(reading)
        changed = self._changed
        self._readings, self._changed = [], set()
        found = (
            self._change(device, readings.get(number, ()), number in changed, now)
            for number, device in self.devices.items()
        )
        return [publication for publication in found if publication is not None]

    def _change(
        self, device: Device, readings: Sequence[Reading], others: bool, now: UnixTime
    ) -> Publication | None:
        if not self._is_alive(device, now):
            if device.sent is None:
                return None
            device.sent = None
            return Publication(self._topic("DDEATH", device.name), encode_payload(_ms(now), (), self._next()))
        if device.sent is None or (others and device.scale != scale_now(self.bus, device.unit)):
            return self._birth(device, now)
        metrics = [metric for reading in readings for metric in self._reading(device, reading)]
        if others:
            metrics += self._differing(device, OF_READING, self._others(device, now), now)
        return self._data(device, metrics, now) if metrics else None

    def _reading(self, device: Device, reading: Reading) -> Iterable[bytes]:
        assert device.scale is not None
        if reading.at <= device.sent_until:
            return ()
        device.sent_until = reading.at
        values = reading_values(self.bus, device.unit, reading, device.scale)
        return self._differing(device, 0, values, reading.at)

    def _differing(
        self, device: Device, first: int, values: Sequence[Value], at: UnixTime
    ) -> Iterable[bytes]:
        """Return the values that differ from those sent, from the tag ``first`` on."""
        sent = device.sent
        assert sent is not None
        found = []
        for place, value in enumerate(values, first):
            if value != sent[place] and self._is_beyond(place, value, sent[place]):
                sent[place] = value
                found.append(encode_value(device.metrics[place], _ms(at), value))
        return found

    def _is_beyond(self, place: int, value: Value, sent: Value) -> bool:
        """Return whether a value differs from the one sent by its deadband."""
        if place >= len(self._thresholds) or not self._thresholds[place]:
            return True
        if not isinstance(value, float) or not isinstance(sent, float):
            return True
        return abs(value - sent) >= self._thresholds[place]

    def _data(self, device: Device, metrics: Iterable[bytes], now: UnixTime) -> Publication:
        return Publication(self._topic("DDATA", device.name), encode_payload(_ms(now), metrics, self._next()))

    # --- the past ---

    def is_born(self, unit: int) -> bool:
        """Return whether the device of a unit is born: then its data may be sent."""
        return self.devices[unit].sent is not None

    def historical(
        self, unit: int, rows: Iterable[tuple[UnixTime, Mapping[str, Value]]], now: UnixTime
    ) -> list[Publication]:
        """Return rows of a unit's history as data, each value that differs from the one before it, marked as
        historical; empty for a dead unit. ``rows``: time and values by `Tag.column`, in order of time."""
        device = self.devices[unit]
        if device.sent is None or device.scale is None:
            return []
        columns = [tag.column for tag in tags_of(device.unit, device.scale)[:OF_READING]]
        last: dict[str, Value] = {}
        metrics: list[bytes] = []
        for at, row in rows:
            for place, column in enumerate(columns):
                if column not in last or row[column] != last[column]:
                    last[column] = row[column]
                    value = device.metrics[place]
                    metrics.append(encode_value(value, _ms(at), row[column], is_historical=True))
        return [
            self._data(device, metrics[start : start + HISTORICAL_METRICS], now)
            for start in range(0, len(metrics), HISTORICAL_METRICS)
        ]


def _metric(tag: Tag, alias: int) -> Metric:
    """Return a tag as a metric, with properties that hosts such as Ignition know."""
    properties: dict[str, Value] = {
        "engUnit": tag.unit or None,
        "engLow": None if tag.low is None else float(tag.low),
        "engHigh": None if tag.high is None else float(tag.high),
        "decimals": tag.decimals,
        "documentation": tag.description or None,
    }
    known = {name: value for name, value in properties.items() if value is not None}
    return Metric(tag.name, _TYPES[tag.kind], alias, known)


def _is_rebirth(command: Command) -> bool:
    return command.name == REBIRTH and command.value is True


def _ms(at: UnixTime) -> int:
    """Return the millisecond of a moment, from its microsecond, as the history has readings."""
    return max(0, micros(at) // 1000)
