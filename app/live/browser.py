"""One browser's socket: it gets the newest values, never a queue.

What changed while the socket was busy is merged into one pending update, so a slow browser costs
one update's memory and is always shown the present.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import msgspec

from app.live.screen import Groups

MOST_FRAMES = 300
"""Frames of the trace kept for a browser that cannot keep up; older ones are dropped and counted."""

encode = msgspec.json.Encoder().encode


@dataclass(slots=True)
class Diff:
    """What changed between the numbers ``before`` and ``after``; ``text`` is the same, encoded for all."""

    before: int
    after: int
    at: float
    groups: Groups
    text: str

    @classmethod
    def of(cls, before: int, after: int, at: float, groups: Groups) -> Diff:
        """Encoded once, whoever it goes to."""
        message = {"is": "diff", "p": before, "n": after, "t": round(at, 3), "f": groups}
        return cls(before, after, at, groups, encode(message).decode())


@dataclass(eq=False, slots=True)
class Browser:
    """What one open page wants and has not had yet. ``units``: the pages' own, for the worker's schedule."""

    name: str
    role: str
    language: str
    units: frozenset[tuple[str, int]] = frozenset()
    trace: str = ""
    _pending: Diff | None = None
    _messages: deque[str] = field(default_factory=deque)
    _frames: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_FRAMES))
    _wake: asyncio.Event = field(default_factory=asyncio.Event)

    def tell(self, diff: Diff) -> None:
        """Newest wins: merged with what has not been sent."""
        if self._pending is None:
            self._pending = diff
        else:
            self._pending = _merged(self._pending, diff)
        self._wake.set()

    def say(self, message: dict[str, Any]) -> None:
        """A message of its own, before any diff: snapshot. It makes what was pending worthless."""
        self._pending = None
        self._messages.append(encode(message).decode())
        self._wake.set()

    def show_frames(self, frames: list[dict[str, Any]]) -> None:
        """Frames for whoever follows the trace."""
        self._frames.extend(frames)
        self._wake.set()

    async def next(self) -> list[str]:
        """Wait until there is something; all of it, in order."""
        await self._wake.wait()
        self._wake.clear()
        texts = list(self._messages)
        self._messages.clear()
        if self._pending is not None:
            texts.append(self._pending.text)
            self._pending = None
        if self._frames:
            texts.append(encode({"is": "frames", "frames": list(self._frames)}).decode())
            self._frames.clear()
        return texts


def _merged(older: Diff, newer: Diff) -> Diff:
    groups = {group: dict(fields) for group, fields in older.groups.items()}
    for group, fields in newer.groups.items():
        groups.setdefault(group, {}).update(fields)
    return Diff.of(older.before, newer.after, newer.at, groups)
