"""The forms that bodies, numbers and instants have in requests and responses of the API."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Annotated, Any

import msgspec
from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    InstanceOf,
    PlainSerializer,
    WithJsonSchema,
)
from starlette.responses import Response
from typing_extensions import TypedDict

from bus.instants import UnixTime
from bus.messages import ENGLISH, Message, shown


class StrictBody(BaseModel):
    """A body without unknown members, conversions and infinite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def _each_once(numbers: list[int]) -> list[int]:
    twice = [number for number in numbers if numbers.count(number) > 1]
    if twice:
        raise ValueError(Message.of("number_given_twice", number=str(twice[0])))
    return numbers


UnitAddresses = Annotated[
    list[Annotated[int, Field(ge=1, le=255)]], Field(max_length=255), AfterValidator(_each_once)
]
"""Addresses of units (#17)."""
Numbers = Annotated[
    list[Annotated[int, Field(ge=1, le=40)]], Field(max_length=40), AfterValidator(_each_once)
]
"""Numbers of parameters."""


DATE_TIME = {"type": "string", "format": "date-time"}
"""The schema of an instant: RFC 3339, which ISO 8601 with a zone is."""
Instant = Annotated[str, WithJsonSchema(DATE_TIME)]
"""An instant as :func:`iso` writes it."""
MaybeInstant = Instant | None


def iso(at: UnixTime) -> str:
    """Format an instant, Unix time in seconds, as the API writes it: ISO 8601, UTC, milliseconds."""
    return datetime.fromtimestamp(float(at), UTC).isoformat(timespec="milliseconds")


InstantObject = Annotated[UnixTime, PlainSerializer(iso, return_type=Instant)]
"""A Unix time as the member of a response, which pages format in the language of the reader."""


def _refuse_number(value: object) -> object:
    """Refuse seconds since the epoch, which pydantic takes for a time even if they are text."""
    if isinstance(value, int | float) or (isinstance(value, str) and ":" not in value):
        raise ValueError(Message("fault_not_a_time"))
    return value


ZonedTime = Annotated[AwareDatetime, BeforeValidator(_refuse_number), WithJsonSchema(DATE_TIME)]
"""A time of a request: ISO 8601 with zone, never a number."""


def parse_integer(text: str, digits: int = 18) -> int | None:
    """Return the number that ``text`` writes with 1 to ``digits`` ASCII digits; None for anything else.

    ``int`` alone takes a sign, blanks, underscores and the digits of every script, and raises ValueError
    beyond 4300 of them.
    """
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= digits else None


def attachment(name: str) -> dict[str, str]:
    """Return the header by which a browser stores a response as a file of this name, in plain ASCII."""
    return {"Content-Disposition": f'attachment; filename="{name}"'}


async def json_response(content: Callable[[], object]) -> Response:
    """Send long content as JSON, made in a thread so that the event loop continues."""
    body = await asyncio.to_thread(lambda: msgspec.json.encode(content()))
    return Response(body, media_type="application/json")


class MessageShown(TypedDict):
    """A text for programs; a value that is itself a text is a message too."""

    code: Annotated[str, Field(description="Which text it is.")]
    params: Annotated[dict[str, Any], Field(description="Its values, by name.")]
    detail: Annotated[str, Field(description="The text, English.")]


MaybeMessage = Annotated[
    MessageShown | None, Field(description="The field before it as data; null: it is empty.")
]


class ReasonShown(TypedDict):
    """The text of a response for programs."""

    reason: Annotated[str, Field(description="Which text detail is: more exact than code.")]
    params: Annotated[dict[str, int | float | str], Field(description="The values in detail, by name.")]
    detail: Annotated[str, Field(description="What happened, why, and what to do; for people.")]


_REMARKS = frozenset({"nothing_sent", "outcome_because"})
"""Texts that only add a remark to their ``reason``."""


def _subject(message: Message) -> Message:
    """Return the message at the core of a text, without the remarks that were added to it."""
    inner = message.params.get("reason") if message.code in _REMARKS else None
    return _subject(inner) if isinstance(inner, Message) else message


def reason_shown(message: Message) -> ReasonShown:
    """Return a text with the code and the values of its core message, each value a number or an English
    text."""
    subject = _subject(message)
    params = {
        name: value if isinstance(value, (int, float)) else shown(value, ENGLISH)
        for name, value in subject.params.items()
    }
    return {"reason": subject.code, "params": params, "detail": str(message)}


def message_shown(message: Message) -> MessageShown:
    return {"code": message.code, "params": msgspec.to_builtins(message.params), "detail": str(message)}


MessageObject = Annotated[InstanceOf[Message], PlainSerializer(message_shown, return_type=MessageShown)]
"""A message as the member of a response: one object, which pages render in the language of the reader."""


def maybe_shown(message: Message | None) -> MessageShown | None:
    """Return a message in the form for programs; None for None."""
    return None if message is None else message_shown(message)
