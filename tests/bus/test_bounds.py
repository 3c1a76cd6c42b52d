"""Nothing that a worker or an app can send is without bounds, and no number is infinite or none."""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec
import pytest
from msgspec import inspect

from bus.contract import AppMessage, MalformedMessageError, WorkerMessage, decode_from_worker

UNBOUNDED = {"Hello.version", "Welcome.version", "Message.params"}
"""Integers that are compared or shown, nothing else; MessagePack's have 64 bits at most."""


def unbounded(kind: inspect.Type, place: str = "") -> Iterator[str]:
    """Where a value may be of any size."""
    match kind:
        case inspect.UnionType(types=types):
            for each in types:
                yield from unbounded(each, place)
        case inspect.StructType(cls=cls, fields=fields):
            # A message limits the depth of those in it.
            for field in () if place.startswith("Message.") else fields:
                yield from unbounded(field.type, f"{cls.__name__}.{field.name}")
        case inspect.IntType(ge=None) | inspect.IntType(le=None):
            yield place
        case inspect.FloatType(ge=None) | inspect.FloatType(le=None):
            yield place
        case inspect.StrType(max_length=None) | inspect.BytesType(max_length=None):
            yield place
        case inspect.ListType(item_type=item, max_length=longest):
            yield from [place] if longest is None else ()
            yield from unbounded(item, place)
        case inspect.DictType(key_type=key, value_type=value, max_length=longest):
            yield from [place] if longest is None else ()
            yield from unbounded(key, place)
            yield from unbounded(value, place)


@pytest.mark.parametrize("message", [WorkerMessage, AppMessage])
def test_every_field_has_bounds(message: type) -> None:
    assert set(unbounded(inspect.type_info(message))) <= UNBOUNDED


@pytest.mark.parametrize("number", [math.inf, -math.inf, math.nan, -1.0, 1e300])
@pytest.mark.parametrize("place", ["sent_at", "at"])
def test_a_number_that_is_none_makes_no_message(place: str, number: float) -> None:
    reading = {"is": "reading", "unit": 1, "at": 1.7e9, "commanded": 0, "actual": 0, "analog": 0}
    update = {**reading, "outputs": 0, "inputs": 0}
    batch = {"is": "batch", "seq": 1, "sent_at": 1.7e9, "updates": [update]}
    decode_from_worker(msgspec.msgpack.encode(batch))
    (update if place == "at" else batch)[place] = number
    with pytest.raises(MalformedMessageError):
        decode_from_worker(msgspec.msgpack.encode(batch))
