"""Sparkplug B payloads as bytes (Sparkplug 3.0, 6.4.1: Protocol Buffers of its schema). Pure.

Written by hand from the field numbers of the schema: of 60 fields an edge node needs 20.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

Value = bool | int | float | str | None

_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
"""The wire types of Protocol Buffers."""
MAX_METRICS: Final = 1000
"""The most metrics that are read of a command."""


class DataType(IntEnum):
    """The data types that Lineside sends (Sparkplug 3.0, 6.4.16)."""

    INT32 = 3
    INT64 = 4
    DOUBLE = 10
    BOOLEAN = 11
    STRING = 12


@dataclass(frozen=True, slots=True)
class Metric:
    """A named value of a node or device. ``alias`` None: it is always named; ``properties``: such as its
    engineering unit."""

    name: str
    datatype: DataType
    alias: int | None = None
    properties: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Command:
    """A metric that a host wants to set. ``value`` None: of a type that is not read."""

    name: str
    alias: int | None
    value: Value


class PayloadError(ValueError):
    """Raised for bytes that are not a Sparkplug payload."""


# --- encoding ---


def encode_payload(timestamp_ms: int, metrics: Iterable[bytes], seq: int | None) -> bytes:
    """Return a payload. ``metrics``: each by `encode_birth` or `encode_value`; ``seq``: None for a death of
    the node (Sparkplug 3.0, 6.4.21)."""
    parts = [_number(1, timestamp_ms)]
    parts += [_bytes(2, metric) for metric in metrics]
    if seq is not None:
        parts.append(_number(3, seq))
    return b"".join(parts)


def encode_birth(metric: Metric, timestamp_ms: int, value: Value) -> bytes:
    """Return a metric with its name, type and properties, as for a birth."""
    parts = [_text(1, metric.name)]
    if metric.alias is not None:
        parts.append(_number(2, metric.alias))
    parts += [_number(3, timestamp_ms), _number(4, metric.datatype)]
    if value is None:
        parts.append(_number(7, 1))
    if metric.properties:
        parts.append(_bytes(9, _properties(metric.properties)))
    parts.append(_value(metric.datatype, value))
    return b"".join(parts)


def encode_value(metric: Metric, timestamp_ms: int, value: Value, *, is_historical: bool = False) -> bytes:
    """Return a metric with only its alias, as for DATA after a birth (Sparkplug 3.0, 6.4.6)."""
    assert metric.alias is not None
    parts = [_number(2, metric.alias), _number(3, timestamp_ms)]
    if is_historical:
        parts.append(_number(5, 1))
    if value is None:
        parts.append(_number(7, 1))
    parts.append(_value(metric.datatype, value))
    return b"".join(parts)


def _properties(properties: Mapping[str, Value]) -> bytes:
    """Return a PropertySet: the keys, then as many values."""
    keys = b"".join(_text(1, key) for key in properties)
    return keys + b"".join(_bytes(2, _property(value)) for value in properties.values())


def _property(value: Value) -> bytes:
    match value:
        case bool():
            return _number(1, DataType.BOOLEAN) + _number(7, value)
        case int():
            return _number(1, DataType.INT32) + _number(3, value & 0xFFFF_FFFF)
        case float():
            return _number(1, DataType.DOUBLE) + _tag(6, _EIGHT) + struct.pack("<d", value)
        case _:
            return _number(1, DataType.STRING) + (_number(2, 1) if value is None else _text(8, value))


def _value(datatype: DataType, value: Value) -> bytes:
    """Return the value of a metric; a negative integer as two's complement (Sparkplug 3.0, 6.4.16)."""
    match datatype, value:
        case _, None:
            return b""
        case DataType.BOOLEAN, _:
            return _number(14, bool(value))
        case DataType.DOUBLE, int() | float():
            return _tag(13, _EIGHT) + struct.pack("<d", value)
        case DataType.INT32, int():
            return _number(10, value & 0xFFFF_FFFF)
        case DataType.INT64, int():
            return _number(11, value & 0xFFFF_FFFF_FFFF_FFFF)
        case _:
            return _text(15, str(value))


_TAGS = [[bytes([number << 3 | kind]) for kind in range(6)] for number in range(16)]
"""The key of each written field, which is one byte."""


def _tag(number: int, kind: int) -> bytes:
    return _TAGS[number][kind]


def _number(number: int, value: int) -> bytes:
    return _tag(number, _VARINT) + _varint(value)


def _bytes(number: int, value: bytes) -> bytes:
    return _tag(number, _BYTES) + _varint(len(value)) + value


def _text(number: int, value: str) -> bytes:
    return _bytes(number, value.encode())


def _varint(value: int) -> bytes:
    if value < 0x80:
        return value.to_bytes(1, "little")
    found = bytearray()
    while value >= 0x80:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    found.append(value)
    return bytes(found)


# --- decoding of commands ---


def commands_in(payload: bytes) -> list[Command]:
    """Return the metrics of an NCMD or DCMD. Raise PayloadError for other bytes."""
    try:
        metrics = [value for number, value in _fields(payload) if number == 2 and isinstance(value, bytes)]
        if len(metrics) > MAX_METRICS:
            raise PayloadError
        return [_command(metric) for metric in metrics]
    except (IndexError, UnicodeDecodeError, struct.error):
        raise PayloadError from None


def _command(metric: bytes) -> Command:
    name, alias = "", None
    value: Value = None
    for number, content in _fields(metric):
        match number, content:
            case 1, bytes():
                name = content.decode()
            case 2, int():
                alias = content
            case 14, int():
                value = bool(content)
            case ((10 | 11), int()):
                value = content
    return Command(name, alias, value)


def _fields(content: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield the fields of a message: the number, and an integer or the bytes. Raise PayloadError, or
    IndexError if the message is cut off."""
    at = 0
    while at < len(content):
        key, at = _read_varint(content, at)
        number, kind = key >> 3, key & 7
        if kind == _VARINT:
            value, at = _read_varint(content, at)
            yield number, value
            continue
        if kind == _BYTES:
            length, at = _read_varint(content, at)
        elif kind in (_EIGHT, _FOUR):
            length = 8 if kind == _EIGHT else 4
        else:
            raise PayloadError
        if at + length > len(content):
            raise PayloadError
        yield number, content[at : at + length]
        at += length


def _read_varint(content: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
        if shift > 63:
            raise PayloadError
