"""A message is data: it comes from other processes too, and is filled in by name alone."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

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
    assert str(Message("unit_refused")) == "unit {unit} rejected the command: {error}"


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
