"""What frames mean, in the language of the page."""

from __future__ import annotations

import pytest

from app.line.live.fields import frame_fields
from bus.contract import MAX_MEANING, Frame
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.commands import WriteParameterRequest, encode_request
from bus.wire.describe import describe_bytes
from tests.app.screens import translator


def test_a_frame_in_german() -> None:
    (described,) = describe_bytes(encode_request(WriteParameterRequest(3, 6, 50), Dialect()))
    frame = Frame(at=100.1234, direction="out", data=described.wire, meanings=[described.meaning])
    assert frame_fields(frame, translator("de")) == {
        "at": 100.1234,
        "direction": "out",
        "hex": "10 02 03 86 06 00 00 00 32 10 03 3F",
        "meaning": "Regler 3: Hochlauframpe (Parameter 6) = 50 schreiben",
        "valid": True,
    }
    assert frame.meaning == "unit 3: write Acceleration Ramp Rate (parameter 6) = 50"


def test_each_statement_of_a_frame_is_shown() -> None:
    noise = Message.of("noise", count=2, reason=Message("noise_outside"))
    frame = Frame(at=1.0, direction="in", data=b"", meanings=[noise, Message("ack")])
    assert frame_fields(frame, translator("de"))["meaning"] == (
        "2 Byte, die kein Telegramm sind: außerhalb eines Telegramms; ACK, Schreiben angenommen"
    )


@pytest.mark.parametrize("tag", ["en", "de"])
@pytest.mark.parametrize(
    ("message", "meaning"),
    [
        (
            Message.of("frame_recorded", text="{a.__class__} {a!r} {a:>99999}"),
            "{a.__class__} {a!r} {a:>99999}",
        ),
        (Message.of("frame_recorded", words="x"), "{text}"),
        (Message.of("of_another_version", unit=3), "of_another_version 3"),
        (Message.of("frame_recorded", text="x" * 4_000), "x" * MAX_MEANING),
    ],
)
def test_a_message_of_a_worker_is_no_format(tag: str, message: Message, meaning: str) -> None:
    frame = Frame(at=1.0, direction="in", data=b"", meanings=[message])
    assert frame_fields(frame, translator(tag))["meaning"] == frame.meaning == meaning
