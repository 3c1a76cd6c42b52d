"""Messages of worker and app are bounded, and a command that was held up is late, whatever else was."""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import inspect

from bus.contract import AppMessage, MalformedMessageError, WorkerMessage, decode_from_worker
from bus.contract.session import WINDOW_S, ClockOffset

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


PROMPT_S = 0.001


def send_each_second(clock: ClockOffset, since: float, until: float, ahead: float = 0.0) -> None:
    """Send the time of an app whose clock is ``ahead`` once a second, without delay."""
    now = since
    while now < until:
        clock.observe(now + ahead, now + PROMPT_S)
        now += 1.0


@given(st.floats(0.6, 300.0), st.floats(0.0, 1.0))
def test_a_stall_of_any_length_makes_no_deadline_later(stall_s: float, phase_s: float) -> None:
    clock, frozen_at = ClockOffset(), 100.0 + phase_s
    send_each_second(clock, 0.0, 100.0)
    thawed_at = frozen_at + stall_s
    sent_at = 101.0
    while sent_at < thawed_at:
        clock.observe(sent_at, thawed_at)
        sent_at += 1.0
    assert clock.here(frozen_at) <= frozen_at + 2 * PROMPT_S


def test_another_clock_is_reckoned_with() -> None:
    clock = ClockOffset()
    send_each_second(clock, 0.0, 5.0, ahead=3600.0)
    assert clock.here(3600.0) == pytest.approx(PROMPT_S)


def test_a_clock_set_ahead_is_followed_at_once_and_one_set_back_after_two_windows() -> None:
    clock = ClockOffset()
    send_each_second(clock, 0.0, 5.0)
    send_each_second(clock, 5.0, 6.0, ahead=60.0)
    assert clock.here(65.0) == pytest.approx(5.0 + PROMPT_S)
    send_each_second(clock, 6.0, 6.0 + 2 * WINDOW_S + 2)
    assert clock.here(30.0) == pytest.approx(30.0 + PROMPT_S)


def test_before_the_first_message_of_the_app_its_clock_is_ours() -> None:
    assert ClockOffset().here(5.0) == 5.0
