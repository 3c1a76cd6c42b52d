"""Messages in a column: JSON, as the API has them."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from bus.messages import Message

UNREADABLE = Message("stored_text_unreadable")
_DECODER = msgspec.json.Decoder(list[Message])


def stored_messages(messages: Sequence[Message]) -> str:
    return msgspec.json.encode(messages).decode()


def messages_of(text: str) -> list[Message]:
    """The messages of a column. A text that holds none, which nothing here writes, is shown as unreadable."""
    try:
        return _DECODER.decode(text)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return [UNREADABLE]
