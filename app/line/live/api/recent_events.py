"""The newest Server-Sent Events (WHATWG HTML, 9.2) of ``GET /stream``, numbered without a gap: what a program
missed a moment ago is still here. Pure.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from app.core.web.api.shape import parse_integer

PIECE_BYTES = 64 * 1024
"""How much a program is given at a time."""

_encode = msgspec.json.Encoder().encode


class StreamEvent(NamedTuple):
    """``bus``: None for the site."""

    bus: str | None
    text: bytes


class RecentEvents:
    """``run``: distinguishes the numbers of this server from those before it was started."""

    def __init__(self, run: str, most_bytes: int) -> None:
        self._run = run
        self._most_bytes = most_bytes
        self._events: dict[int, StreamEvent] = {}
        self._size = 0
        self.newest = 0

    def add(self, kind: str, bus: str | None, data: dict[str, Any]) -> None:
        """One more; the oldest go where it would be too many."""
        self.newest += 1
        event = StreamEvent(bus, self.text(kind, self.newest, data))
        self._events[self.newest] = event
        self._size += len(event.text)
        while self._size > self._most_bytes:
            oldest = self._events.pop(self.newest - len(self._events) + 1)
            self._size -= len(oldest.text)

    def interrupt(self) -> None:
        """Events were not noted for a while: no client can resume before it."""
        self._events.clear()
        self._size = 0
        self.newest += 1

    def text(self, kind: str, number: int, data: dict[str, Any]) -> bytes:
        """An event as it is sent. JSON has no line break, which would end it."""
        id_ = f"{self._run}-{number}"
        return f"id: {id_}\nevent: {kind}\ndata: ".encode() + _encode(data) + b"\n\n"

    def number_of(self, last_event_id: str) -> int | None:
        """The number in an id; None where it is none of this run."""
        run, _, number = last_event_id.rpartition("-")
        return parse_integer(number) if run == self._run else None

    def has_all_after(self, number: int) -> bool:
        """Whether every event after this number is still here."""
        return self.newest - len(self._events) <= number <= self.newest

    def after(self, number: int, bus: str | None) -> tuple[int, bytes]:
        """Events after ``number``, which are all here, in one piece, and the number of the last of them.
        ``bus``: only those of this bus and of the site; None: all.
        """
        texts: list[bytes] = []
        size = 0
        while number < self.newest and size < PIECE_BYTES:
            number += 1
            event = self._events[number]
            if bus is None or event.bus in (None, bus):
                texts.append(event.text)
                size += len(event.text)
        return number, b"".join(texts)
