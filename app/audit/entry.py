"""An entry of the log before it is chained: every field in the type in which the store returns it, as the
hash is made of the written values and compared with those read. Pure."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

from bus.contract import Frame
from bus.instants import UnixTime
from bus.messages import Message

Event = dict[str, Any]
"""One event with its result, as `app.audit.reading.readable` gives it."""

LATEST = 253_370_764_800.0
"""The year 9999: no date of the screen or of ISO 8601 goes further. Unix time in seconds."""
_OPTIONAL = ("about", "bus", "unit", "old", "new", "old_raw", "new_raw", "outcome", "count")
_TEXTS = ("who", "origin", "what", "message")
MESSAGE_COLUMNS = ("who", "origin", "what", "old", "new", "message")
"""The fields that may be messages."""


def new_entry(*, kind: str, time: UnixTime, frames: Iterable[Frame] = (), **given: Any) -> dict[str, Any]:
    """All fields of an entry but its id. ``time``: Unix time in seconds; ``frames`` carried the command. Of a
    message the field has the text in English, and ``messages`` what it is."""
    shown = json.dumps([_frame(frame) for frame in frames], separators=(",", ":"), ensure_ascii=False)
    entry = {**dict.fromkeys(_OPTIONAL), **dict.fromkeys(_TEXTS, ""), **given, "kind": kind, "frames": shown}
    messages = {name: _plain(entry[name]) for name in MESSAGE_COLUMNS if isinstance(entry[name], Message)}
    entry |= {name: str(entry[name]) for name in messages}
    entry["messages"] = json.dumps(messages, separators=(",", ":"), ensure_ascii=False) if messages else None
    # SQLite has no negative zero.
    return {name: _stored(value) for name, value in entry.items()} | {"time": float(time) + 0.0}


def is_moment(time: UnixTime) -> bool:
    """Whether a Unix time in seconds can be shown as a date; 0 means an unknown time."""
    return math.isfinite(time) and 0 < float(time) < LATEST


def _plain(message: Any) -> Any:
    """A message as JSON has it, each text as it is stored."""
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
