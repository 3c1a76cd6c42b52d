"""Messages of other processes are data, and bounded; the clock by which their lateness is judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import inspect

from bus.contract import AppMessage, MalformedMessageError, WorkerMessage, decode_from_worker
from bus.contract.session import WINDOW_S, ClockOffset
from bus.messages import DEEPEST, LARGEST, MAX_TEXT, Message, joined, number

_DECODE = msgspec.msgpack.Decoder(Message).decode


def nested(depth: int) -> dict[str, object]:
    inner: dict[str, object] = {"code": "x", "params": {}}
    for _ in range(depth):
        inner = {"code": "x", "params": {"a": [inner]}}
    return inner


def test_its_text_in_english() -> None:
    message = Message.of("unit_refused", unit=3, error=Message("illegal_speed"))
    assert str(message) == "unit 3 rejected the command: illegal speed value"


@pytest.mark.parametrize("value", ["{unit}", "{unit.__class__}", "{0}", "{unit:>999999999}", "%s"])
def test_a_value_is_no_format(value: str) -> None:
    assert str(Message.of("unit_refused", unit=3, error=value)) == f"unit 3 rejected the command: {value}"


def test_a_value_that_lacks_leaves_its_braces() -> None:
    assert str(Message("unit_refused")) == "{unit_name} rejected the command: {error}"


def test_a_code_of_another_version_is_shown_with_its_values() -> None:
    assert str(Message.of("from_next_year", unit=3, limit=number("1.5"))) == "from_next_year 3 1.5"


def test_lists_are_joined() -> None:
    error = [Message("illegal_speed"), Message("illegal_command")]
    assert str(Message.of("unit_refused", unit=[1, 2], error=error)) == (
        "unit 1, 2 rejected the command: illegal speed value; illegal command"
    )


def test_it_is_no_longer_than_any_text() -> None:
    message = Message.of("unit_refused", unit=3, error=["x" * MAX_TEXT] * 10)
    assert len(str(message)) == MAX_TEXT


def test_it_survives_the_wire() -> None:
    message = Message.of("unit_refused", unit=3, error=[Message("illegal_speed"), 1, "x"])
    assert _DECODE(msgspec.msgpack.encode(message)) == message
    assert hash(_DECODE(msgspec.msgpack.encode(message))) == hash(message)


@pytest.mark.parametrize(
    "hostile",
    [
        nested(DEEPEST + 1),
        nested(3_000),
        {"code": "Not a code", "params": {}},
        {"code": "x" * 61, "params": {}},
        {"code": "x", "params": {"a": "y" * (MAX_TEXT + 1)}},
        {"code": "x", "params": {"a": [1] * 501}},
        {"code": "x", "params": {"a": float("nan")}},
        {"code": "x", "params": {"a": {"b": 1}}},
        {"code": "x", "params": {str(n): n for n in range(21)}},
        {"code": "x", "params": {"a": ["y" * MAX_TEXT] * (1 + LARGEST // MAX_TEXT)}},
        {"code": "x", "params": {str(n): [1] * 500 for n in range(20)}},
    ],
)
def test_params_beyond_the_bounds_are_refused(hostile: dict[str, object]) -> None:
    with pytest.raises((msgspec.ValidationError, RecursionError)):
        _DECODE(msgspec.msgpack.encode(hostile))


def test_the_results_of_every_unit_fit_into_one_message() -> None:
    one = Message.of("unit_refused", unit=255, error=Message.of("illegal_speed", code=130, name="x" * 20))
    several = joined([one] * 255)
    assert several is not None
    assert several.params == {"messages": [one] * 255}


def test_a_question_among_several_texts_ends_its_own_sentence() -> None:
    question = Message.of("port_missing", port="/dev/tty-1")
    assert "plugged in? /dev" in str(joined([question, question]))


def test_what_would_be_too_large_is_text() -> None:
    large = Message.of("x", a=["y" * (LARGEST // 10)] * 6)
    together = Message.of("z", first=large, second=large)
    assert all(isinstance(value, str) and len(value) <= MAX_TEXT for value in together.params.values())


@pytest.mark.parametrize(
    "wrap", [lambda inner: Message.of("x", a=inner), lambda inner: joined([inner, inner])]
)
def test_a_message_of_another_process_can_always_be_put_into_one(wrap: Callable[[Message], Message]) -> None:
    """A worker that sends the deepest there may be must not end a restore in the middle."""
    message = _DECODE(msgspec.msgpack.encode(nested(DEEPEST)))
    for _ in range(2 * DEEPEST):
        message = wrap(message)
        assert _DECODE(msgspec.msgpack.encode(message)) == message
    assert str(message)


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
