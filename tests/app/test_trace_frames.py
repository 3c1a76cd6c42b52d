"""What frames say, in the language of the page."""

from __future__ import annotations

import re
from collections.abc import Iterable

import pytest
from bus.clauses import LONGEST, Clause

from app.live.trace_frames import frame_fields
from app.messages import Languages
from bus.contract import Frame
from bus.errors import UnitErrorCode
from bus.line.statistics.trace import HIDDEN
from bus.settings import Dialect
from bus.wire.bodies import encode_reply, encode_request
from bus.wire.commands import (
    Ack,
    ExecuteSpeed,
    Nak,
    ParameterReply,
    ReadParameter,
    ReadStatus,
    Request,
    SetAndExecuteSpeed,
    StageSpeed,
    StatusReply,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.wire.describe import describe_bytes
from bus.wire.framing import Fault
from tests.app.screens import voice

PLAIN = Dialect()
REQUESTS: list[Request] = [
    ReadStatus(3),
    StageSpeed(3, 500),
    ExecuteSpeed(0),
    SetAndExecuteSpeed(3, 500),
    ReadParameter(3, 6),
    ReadParameter(3, 99),
    WriteParameter(3, 6, 50),
    WriteParameter(3, 21, 4711),
    WriteOutput(3, 2, on=True),
    WriteOutput(3, 2, on=False),
    WriteAnalogOutput(3, 99),
]
ALIKE = {"remote", "NAK"}
"""Said the same in both languages."""


def clauses_of(*frames: bytes) -> list[Clause]:
    return [clause for item in describe_bytes(b"".join(frames), PLAIN) for clause in item.clauses]


def asked_and_answered() -> Iterable[Clause]:
    every_bit = StatusReply(3, 500, 499, 12, 0xFF, 0xFF)
    no_bit = StatusReply(3, 500, 499, 12, 0, 0)
    for request in REQUESTS:
        asked = encode_request(request, PLAIN)
        yield from clauses_of(asked)
        yield from clauses_of(asked, encode_reply(Ack(3), PLAIN))
        yield from clauses_of(asked, encode_reply(Ack(3, b"\x00\x32"), PLAIN))
        for code in (*UnitErrorCode, 0x99):
            yield from clauses_of(asked, encode_reply(Nak(3, code), PLAIN))
    for answer in (every_bit, no_bit, ParameterReply(3, 50, 2), Ack(3), Ack(3, b"123"), Nak(3, 0x80)):
        yield from clauses_of(encode_reply(answer, PLAIN))
    yield from clauses_of(
        encode_request(ReadParameter(3, 6), PLAIN), encode_reply(ParameterReply(3, 50, 2), PLAIN)
    )


def rubbish() -> Iterable[Clause]:
    yield from clauses_of(b"\x55\xaa")
    yield from clauses_of(bytes.fromhex("10 02 04 82 00 00 02 10 10 10 03 67"))
    for body in ("01 99", "01 87 01 07", "01 85 AA"):
        content = bytes.fromhex(body)
        yield from clauses_of(b"\x10\x02" + content + b"\x10\x03" + bytes((-sum(content) & 0xFF,)))
    yield from (Clause(fault.value) for fault in Fault)
    yield HIDDEN


def english_words(clause: Clause) -> Iterable[str]:
    """The text and the words among its values, without the manual's names of parameters."""
    yield clause.text
    for value in clause.values.values():
        if isinstance(value, str) and re.search("[a-z]{2}", value) and not re.match(r"#\d+ [A-Z]", value):
            yield value


@pytest.mark.parametrize("language", [each.tag for each in Languages() if each.tag != "en"])
def test_whatever_a_frame_says_is_said_in_every_language(language: str) -> None:
    t = Languages()[language].t
    texts = {text for clause in (*asked_and_answered(), *rubbish()) for text in english_words(clause)}
    assert len(texts) > 40
    assert {text for text in texts if t(text) == text} - ALIKE == set()


def test_a_frame_in_german() -> None:
    (asked,) = describe_bytes(encode_request(WriteParameter(3, 6, 50), PLAIN), PLAIN)
    frame = Frame(at=100.1234, direction="out", data=asked.wire, clauses=list(asked.clauses))
    assert frame_fields(frame, voice("de")) == {
        "at": 100.1234,
        "direction": "out",
        "hex": "10 02 03 86 06 00 00 00 32 10 03 3F",
        "meaning": "Regler 3: Parameter #6 Acceleration Ramp Rate = 50 schreiben",
        "valid": True,
    }
    assert frame.meaning == "unit 3: write parameter #6 Acceleration Ramp Rate = 50"


@pytest.mark.parametrize("tag", ["en", "de"])
@pytest.mark.parametrize(
    ("clause", "meaning"),
    [
        (
            Clause("{a.__class__} {a[0]} {a!r} {a:>99999}", {"a": "x"}),
            "{a.__class__} {a[0]} {a!r} {a:>99999}",
        ),
        (Clause("{}", {"": 1}), "{}"),
        (Clause("{a", {"a": 1}), "{a"),
        (Clause("{missing} {a}", {"a": "{a}"}), "{missing} {a}"),
        (Clause("a: " * 90), "a: " * 90),
        (Clause("{a}" * 100, {"a": "x" * 300}), "x" * LONGEST),
    ],
)
def test_a_workers_words_are_no_format_and_no_pattern(tag: str, clause: Clause, meaning: str) -> None:
    frame = Frame(at=1.0, direction="in", data=b"", clauses=[clause])
    assert frame_fields(frame, voice(tag))["meaning"] == frame.meaning == meaning


def test_a_meaning_of_many_clauses_is_bounded() -> None:
    frame = Frame(at=1.0, direction="in", data=b"", clauses=[Clause("x" * 300)] * 30)
    assert len(frame.meaning) == len(frame_fields(frame, voice("de"))["meaning"]) == LONGEST
