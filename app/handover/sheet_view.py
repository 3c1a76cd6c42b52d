"""A sheet as templates show it: its texts are messages, which each reader has in their language."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

import msgspec

from app.handover.sheet import SECTIONS
from bus.instants import UnixTime
from bus.messages import Message

TRANSITIONS = ("standing", "shelved", "suppressed", "out_of_service", "drift")
"""A sheet that was signed by an earlier version has no `suppressed`: of those it states nothing."""


def readable_sheet(stored: bytes) -> dict[str, Any]:
    """The sheet of its JSON, with moments for instants and messages for texts."""
    sheet: dict[str, Any] = msgspec.json.decode(stored)
    for event in _events(sheet):
        event["messages"] = msgspec.convert(event["messages"], dict[str, Message])
        event["time"] = _moment(event["time"])
    for name in TRANSITIONS:
        if name in sheet:
            sheet[name] = [readable_transition(each) for each in sheet[name]]
    sheet["notes"] = readable_notes(sheet["notes"])
    sheet |= {name: _moment(sheet[name]) for name in ("start", "end", "until", "made_at")}
    sheet["omissions"] = msgspec.convert(sheet["omissions"], list[Message])
    return sheet


def readable_transition(transition: Mapping[str, Any]) -> dict[str, Any]:
    """A transition of the API, with a moment for its instant and messages for its texts."""
    return {
        **transition,
        "time": _moment(transition["time"]),
        "title": _title(transition),
        "state": Message(f"alarm_state_{transition['after']}"),
    }


def readable_notes(notes: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Notes of the API, with moments for instants."""
    return [
        {**note, "time": _moment(note["time"]), "written_at": _moment(note["written_at"])} for note in notes
    ]


def _events(sheet: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield from sheet["blocked"]
    yield from sheet["control_before"]
    for name in SECTIONS:
        yield from sheet[name]["events"]


def _moment(text: str | None) -> UnixTime | None:
    if text is None:
        return None
    return UnixTime(datetime.fromisoformat(text).timestamp())


def _title(transition: Mapping[str, Any]) -> str | Message:
    """The name of an alarm; of a built-in one as a message."""
    alarm, code = transition["alarm"].rpartition(".")[0], transition["code"]
    return Message(f"alarm_{code}") if alarm.endswith(f".{code}") else str(transition["name"])
