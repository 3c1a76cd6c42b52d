"""The records of the spool as bytes: framed, numbered, packed, each with its checksum. Pure."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import msgspec

from app.history.intake.updates import Delivery
from app.history.series import columns
from app.history.series.runs import SECOND, micros
from app.history.series.scaling import DECIDING
from bus.contract import BusLink, ParameterValue, Reading, UnitLink, Update
from bus.instants import UnixTime

MAGIC = b"LsSp"
_HEAD = struct.Struct("<4sII")
"""Magic, length of what follows, its checksum."""
_FACTS = struct.Struct("<QqqIB")
_LEVEL = 1
_Kept = UnitLink | BusLink | ParameterValue
SpooledUpdate = _Kept | Reading


class Facts(NamedTuple):
    """Facts of a record, known without unpacking it. Numbers rise by 1; times in µs, of its readings."""

    number: int
    begin: int
    end: int
    readings: int
    is_repeated: bool
    """Whether an attempt to store it failed, and may have succeeded all the same."""


class Record(NamedTuple):
    """A record and where it is among the bytes that were searched."""

    facts: Facts
    start: int
    stop: int
    content: bytes


class _Part(msgspec.Struct, array_like=True):
    bus: str
    readings: bytes
    others: list[_Kept]


_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(list[_Part])


def pack(number: int, deliveries: Iterable[Delivery], *, is_repeated: bool = False) -> bytes | None:
    """The part of deliveries that belongs to history as one record; None where there is none."""
    parts = [_packed(bus, updates) for bus, updates in deliveries]
    times = [at for _, times in parts for at in times]
    kept = [part for part, times in parts if times or part.others]
    if not kept:
        return None
    facts = Facts(number, min(times, default=0), max(times, default=0), len(times), is_repeated)
    body = _FACTS.pack(*facts) + zlib.compress(_ENCODER.encode(kept), _LEVEL)
    return _HEAD.pack(MAGIC, len(body), zlib.crc32(body)) + body


def unpack(content: bytes) -> list[tuple[str, list[SpooledUpdate]]]:
    """The deliveries of a record. Raises ValueError where it was not written by this version."""
    try:
        parts = _DECODER.decode(zlib.decompress(content))
    except (zlib.error, msgspec.MsgspecError) as error:
        raise ValueError(f"a record of the spool cannot be read: {error}") from error
    return [(part.bus, [*part.others, *_readings(part.readings)]) for part in parts]


def records_in(data: bytes) -> Iterator[Record]:
    """Every intact record, in order. What is between is passed over: a torn end, or damage."""
    at = 0
    while (at := data.find(MAGIC, at)) >= 0:
        found = _record_at(data, at)
        if found is not None:
            yield found
        at = at + 1 if found is None else found.stop


def _record_at(data: bytes, at: int) -> Record | None:
    begin = at + _HEAD.size
    if begin > len(data):
        return None
    _, length, checksum = _HEAD.unpack_from(data, at)
    body = data[begin : begin + length]
    if len(body) < max(length, _FACTS.size) or zlib.crc32(body) != checksum:
        return None
    number, first, last, readings, is_repeated = _FACTS.unpack_from(body)
    facts = Facts(number, first, last, readings, bool(is_repeated))
    return Record(facts, at, begin + length, body[_FACTS.size :])


def _packed(bus: str, updates: Iterable[Update]) -> tuple[_Part, list[int]]:
    read = [update for update in updates if type(update) is Reading]
    others = [update for update in updates if isinstance(update, UnitLink | BusLink) or _is_deciding(update)]
    times = [micros(each.at) for each in read]
    table = [
        [each.unit for each in read],
        times,
        [each.commanded for each in read],
        [each.actual for each in read],
        [each.analog for each in read],
        [each.outputs << 8 | each.inputs for each in read],
    ]
    return _Part(bus, columns.pack(table, 0) if read else b"", others), times  # type: ignore[arg-type]


def _is_deciding(update: Update) -> bool:
    return isinstance(update, ParameterValue) and update.number in DECIDING


def _readings(packed: bytes) -> Iterator[Reading]:
    if packed:
        for unit, at, commanded, actual, analog, word in zip(*columns.unpack(packed), strict=True):
            yield Reading(unit, UnixTime(at / SECOND), commanded, actual, analog, word >> 8, word & 0xFF)
