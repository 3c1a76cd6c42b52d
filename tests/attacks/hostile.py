"""Messages that a hostile peer could send: of every type of the contract, within its bounds and beyond."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import msgspec
from hypothesis import strategies as st
from msgspec import inspect

from bus.contract import Update
from bus.messages import NUMBER, TERM, Message
from bus.messages import TEXTS as MESSAGE_TEXTS

Values = st.SearchStrategy[Any]

NUMBERS = st.sampled_from(
    [-1, 0, 1, 2**31, 2**32, 2**63, -(2**63), 1.5, -0.0, 1e308, math.inf, -math.inf, math.nan]
)
TEXTS = st.sampled_from(
    [
        *(
            "",
            "x",
            "x" * 301,
            "x" * 5_000,
            "\x00",
            "\u202e",
            "a\nb",
            "<script>",
            "{{7*7}}",
            "=1+1",
            "': DROP",
        ),
        *(
            "{a}",
            "{a.__class__}",
            "{a[0]}",
            "{b}",
            "{a:>99999999}",
            "{",
            "{}",
            "%s%n",
            ": " * 150,
            "a: b; " * 50,
        ),
    ]
)
NONSENSE = st.one_of(
    NUMBERS,
    TEXTS,
    st.none(),
    st.booleans(),
    st.just([]),
    st.just({}),
    st.just([[[[]]]]),
    st.binary(max_size=8),
)
COMMAND_ID = "c"
"""Of the command that waits for its result."""
CODES = [
    *sorted(MESSAGE_TEXTS)[::7],
    "several",
    NUMBER,
    TERM,
    "change_too_long",
    "of_another_version",
    "x" * 60,
]
UNITS = [1, 2, 3, 255]
"""Of which the line has 1 and 2."""


def times() -> Values:
    """Around now, where the window is, and anywhere."""
    now = time.time()
    near = [now + offset for offset in (-3_600, -61, -1, -0.5, 0, 4)]
    far = [0.0, 1.0, now - 8 * 86_400, now + 6, now + 3_600, 32_503_680_000.0]
    return st.one_of(st.sampled_from(near), st.sampled_from(near), st.sampled_from(far))


def clocks() -> Values:
    """When a message was sent: mostly by the app's own clock, sometimes by one that is far off."""
    now = time.time()
    return st.sampled_from([now] * 6 + [now - 3_600, now + 3_600, 0.0])


def of_type(kind: inspect.Type, name: str = "") -> Values:
    """Values of a type of the contract, its extremes among them."""
    match kind:
        case inspect.UnionType(types=types):
            return st.one_of([of_type(each, name) for each in types])
        case inspect.ListType(item_type=item):
            return st.lists(of_type(item), max_size=3)
        case inspect.DictType(key_type=key, value_type=value):
            keys = st.sampled_from(["a", "0", ""]) if isinstance(key, inspect.StrType) else of_type(key)
            return st.dictionaries(keys, of_type(value), max_size=3)
        case inspect.StructType(cls=cls) if cls is Message:
            return messages()
        case inspect.StructType():
            return _of_struct(kind)
    return _simple(kind, name)


def messages(deepest: int = 2) -> Values:
    """Messages of known and unknown codes, with and without the values of their texts, in one another."""
    texts = TEXTS.map(lambda text: text[:4_000])
    leaf = st.one_of(st.sampled_from([0, -1, 2**63 - 1, 1.5, -1e15]), texts)
    inner = messages(deepest - 1) if deepest else leaf
    values = st.one_of(leaf, st.lists(st.one_of(st.integers(-5, 5), texts, inner), max_size=3), inner)
    names = st.sampled_from(["unit", "n", "value", "text", "messages", "reason", "error", "__class__", ""])
    params = st.dictionaries(names, values, max_size=4)
    return st.fixed_dictionaries({"code": st.sampled_from(CODES), "params": params})


def _simple(kind: inspect.Type, name: str) -> Values:
    match kind:
        case inspect.IntType():
            return _integers(kind, name)
        case inspect.FloatType() if name == "sent_at":
            return clocks()
        case inspect.FloatType(ge=least, le=most):
            return times() if most and most > 1e10 else st.sampled_from([least or 0.0, 0.5, most or 1e300])
        case inspect.StrType(max_length=longest):
            return st.just(COMMAND_ID) if name == "id" else TEXTS.map(lambda text: text[:longest])
        case inspect.BytesType(max_length=longest):
            return st.sampled_from([b"", b"\x10\x02\x01", bytes(longest or 10)])
        case inspect.LiteralType(values=values):
            return st.sampled_from(values)
        case inspect.BoolType():
            return st.booleans()
        case inspect.NoneType():
            return st.none()
    raise TypeError(f"{kind} is in no message")


def _integers(kind: inspect.IntType, name: str) -> Values:
    if name == "unit":
        return st.sampled_from(UNITS)
    low = kind.ge if kind.ge is not None else -(2**63)
    high = kind.le if kind.le is not None else 2**63 - 1
    return st.sampled_from(sorted({low, min(max(3, low), high), high}))


def _of_struct(kind: inspect.StructType) -> Values:
    fields = {field.encode_name: of_type(field.type, field.encode_name) for field in kind.fields}
    if kind.array_like:
        return st.tuples(*fields.values()).map(list)
    tag = {kind.tag_field: st.just(kind.tag)} if kind.tag_field else {}
    return st.fixed_dictionaries(tag | fields)


def batches(seq: int) -> Values:
    """Full ones, most of them live."""
    update = of_type(inspect.type_info(Update))
    fields = {
        "is": st.just("batch"),
        "seq": st.just(seq),
        "sent_at": clocks(),
        "live": st.sampled_from([True, True, True, False]),
        "updates": st.lists(update, min_size=8, max_size=16),
    }
    return st.fixed_dictionaries(fields)


def encoded(messages: Values) -> st.SearchStrategy[bytes]:
    """The messages as bytes."""
    return messages.map(msgspec.msgpack.encode)


@st.composite
def broken(draw: st.DrawFn, messages: Values) -> Any:
    """A message with nonsense at one place of it, however deep."""
    message = draw(messages)
    place: Any = message
    while True:
        keys = list(place) if isinstance(place, Mapping) else list(range(len(place)))
        if not keys:
            return message
        key = draw(st.sampled_from(keys))
        if isinstance(place[key], dict | list) and draw(st.booleans()):
            place = place[key]
            continue
        place[key] = draw(NONSENSE)
        return message


GARBAGE = st.one_of(
    st.binary(max_size=64),
    st.sampled_from(
        [
            b"\x91" * 100_000 + b"\x01",
            b"\x82\xa2is\xa5hello\xa1x" + b"\x91" * 100_000 + b"\x01",
            b"\xdd\xff\xff\xff\xff",
            b"\xdf\xff\xff\xff\xff",
            b"\xc6\xff\xff\xff\xff",
            b"\x81\xa2is\xd9\xff" + b"x" * 255,
            b"\x81\xa2is\xa3\xff\xfe\xfd",
        ]
    ),
)
"""Bytes that are no message: nesting without end, lengths that lie, text that is no text."""
