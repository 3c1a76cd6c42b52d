"""An entry of the log as it is stored, and as it is read back. Pure.

Every field has the type in which the store returns it, since the hash over the written values is compared
with one over those read. Any row can be shown, whatever it holds."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, Literal

import msgspec

from bus.contract import Frame
from bus.instants import UnixTime
from bus.messages import LIST, NUMBER, TERM, TEXTS, Message

Event = dict[str, Any]
"""One event with its result, as :func:`readable` returns it."""
EventKind = Literal[
    "access_refused",
    "alarm",
    "audit",
    "block",
    "bus",
    "clock",
    "command",
    "configuration",
    "control",
    "estop",
    "home",
    "limits",
    "login",
    "notification",
    "login_refused",
    "logout",
    "mode",
    "parameter_set",
    "recipe",
    "restore",
    "run",
    "secret",
    "server",
    "shift",
    "swap",
    "token",
    "unit",
    "user",
    "worker",
]
"""A filter for another kind is refused instead of finding nothing. A log of 0.2 has events of ``home``."""

MAX_TIME = 253_370_764_800.0
"""The year 9999, the last one of dates on the screen and in ISO 8601. Unix time in seconds."""
_OPTIONAL = ("about", "bus", "unit", "old", "new", "old_raw", "new_raw", "outcome", "count")
_TEXTS = ("who", "origin", "what", "message")
MESSAGE_COLUMNS = ("who", "origin", "what", "old", "new", "message")
"""The fields that may be messages."""


def new_entry(*, kind: str, time: UnixTime, frames: Iterable[Frame] = (), **given: Any) -> dict[str, Any]:
    """Return all fields of an entry except its id. ``time``: Unix time in seconds; ``frames``: those that
    carried the command. A field that is a message holds its English text, and ``messages`` has the
    message."""
    shown = json.dumps([_frame(frame) for frame in frames], separators=(",", ":"), ensure_ascii=False)
    entry = {**dict.fromkeys(_OPTIONAL), **dict.fromkeys(_TEXTS, ""), **given, "kind": kind, "frames": shown}
    messages = {name: _plain(entry[name]) for name in MESSAGE_COLUMNS if isinstance(entry[name], Message)}
    entry |= {name: str(entry[name]) for name in messages}
    entry["messages"] = json.dumps(messages, separators=(",", ":"), ensure_ascii=False) if messages else None
    # SQLite has no negative zero.
    return {name: _stored(value) for name, value in entry.items()} | {"time": float(time) + 0.0}


def is_moment(time: UnixTime) -> bool:
    """Return whether a Unix time in seconds can be shown as a date; 0 means an unknown time."""
    return math.isfinite(time) and 0 < float(time) < MAX_TIME


def _plain(message: Any) -> Any:
    """Return a message as JSON has it."""
    match message:
        case Message(code, params):
            return {"code": code, "params": {name: _plain(value) for name, value in params.items()}}
        case list():
            return [_plain(each) for each in message]
        case _:
            return _stored(message)


def _stored(value: Any) -> Any:
    if isinstance(value, str):
        # Half a character, which JSON can escape, is not UTF-8.
        return str(value).encode("utf-8", "backslashreplace").decode()
    return int(value) if isinstance(value, bool) else value


def _frame(frame: Frame) -> dict[str, Any]:
    return {
        "at": frame.at,
        "direction": frame.direction,
        "data": frame.data.hex(" ").upper(),
        "meaning": frame.meaning,
        "meanings": _plain(frame.meanings),
    }


_MESSAGES = msgspec.json.Decoder(dict[str, Message])
_KNOWN = {*TEXTS, NUMBER, TERM, LIST}


class FrameRecord(msgspec.Struct):
    """One frame that carried a command. ``at``: Unix time in seconds; ``data``: hexadecimal."""

    at: UnixTime
    direction: str
    data: str
    meaning: str
    meanings: list[Message] = []


def readable(row: Mapping[str, Any]) -> Event:
    """Return a row as an event. If its time or its frames are invalid, ``unreadable`` is true, the time is 0,
    and the frames are left out. ``messages``: those of its fields with a code of this version."""
    has_time, frames = is_moment(row["time"]), frames_of(row["frames"])
    event = {**row, "unreadable": not has_time or frames is None}
    concluded_at = row["concluded_at"]
    if concluded_at is not None and not is_moment(concluded_at):
        event |= {"concluded_at": None, "unreadable": True}
    parts = [messages_of(row["messages"]), messages_of(row["concluded_messages"])]
    messages = {**(parts[0] or {}), **(parts[1] or {})}
    # Of a code that this version does not have, the stored text is shown.
    event["messages"] = {name: message for name, message in messages.items() if message.code in _KNOWN}
    if None in parts:
        event["unreadable"] = True
    if not has_time:
        event["time"] = 0.0
    if frames is None:
        event["frames"] = "[]"
    return event


def messages_of(text: str | None) -> dict[str, Message] | None:
    """Return the messages of an entry by field, from its JSON; None if it is invalid."""
    if text is None:
        return {}
    try:
        return _MESSAGES.decode(text)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None


def frames_of(text: str) -> list[FrameRecord] | None:
    """Return the frames of an entry from its JSON; None if it is invalid."""
    try:
        frames = msgspec.json.decode(text, type=list[FrameRecord])
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None
    return frames if all(is_moment(frame.at) for frame in frames) else None
