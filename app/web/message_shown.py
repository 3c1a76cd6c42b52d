"""A message as the API gives it: for programs a code with its params, for people its text in English."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import to_builtins
from pydantic import Field
from typing_extensions import TypedDict

from bus.messages import Message


class MessageShown(TypedDict):
    """A text for programs; a value that is itself a text is a message too."""

    code: Annotated[str, Field(description="Which text it is.")]
    params: Annotated[dict[str, Any], Field(description="Its values, by name.")]
    detail: Annotated[str, Field(description="The text, English.")]


MaybeMessage = Annotated[
    MessageShown | None, Field(description="The field before it as data; null: it is empty.")
]


def message_shown(message: Message) -> MessageShown:
    return {"code": message.code, "params": to_builtins(message.params), "detail": str(message)}


def maybe_shown(message: Message | None) -> MessageShown | None:
    """The same; None where there is no message."""
    return None if message is None else message_shown(message)
