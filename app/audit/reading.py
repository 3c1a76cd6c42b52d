"""An event as it is read from the store: whatever the row holds, the result can be shown. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from app.audit.entry import Event, is_moment
from bus.instants import UnixTime
from bus.messages import Message

_MESSAGES = msgspec.json.Decoder(dict[str, Message])


class FrameRecord(msgspec.Struct):
    """One frame that carried a command. ``at``: Unix time in seconds; ``data``: hexadecimal."""

    at: UnixTime
    direction: str
    data: str
    meaning: str
    meanings: list[Message] = []


def readable(row: Mapping[str, Any]) -> Event:
    """The row as an event. Where its time or its frames are invalid, ``unreadable`` is true, the time 0,
    which no event has, and the frames left out. ``messages``: of its fields, where known."""
    has_time, frames = is_moment(row["time"]), frames_of(row["frames"])
    event = {**row, "unreadable": not has_time or frames is None}
    concluded_at = row["concluded_at"]
    if concluded_at is not None and not is_moment(concluded_at):
        event |= {"concluded_at": None, "unreadable": True}
    parts = [messages_of(row["messages"]), messages_of(row["concluded_messages"])]
    event["messages"] = {**(parts[0] or {}), **(parts[1] or {})}
    if None in parts:
        event["unreadable"] = True
    if not has_time:
        event["time"] = 0.0
    if frames is None:
        event["frames"] = "[]"
    return event


def messages_of(text: str | None) -> dict[str, Message] | None:
    """The messages of an entry's fields, by field, from its JSON; None where it is invalid."""
    if text is None:
        return {}
    try:
        return _MESSAGES.decode(text)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None


def frames_of(text: str) -> list[FrameRecord] | None:
    """The frames in the JSON of an entry; None where they are none."""
    try:
        frames = msgspec.json.decode(text, type=list[FrameRecord])
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None
    return frames if all(is_moment(frame.at) for frame in frames) else None
