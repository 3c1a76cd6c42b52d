"""One browser's socket: it gets the newest values, never a queue.

What changed while the socket was busy is merged into one pending update, so a slow browser costs
one update's memory and is always shown the present.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec

from app.live.screen import Groups

MOST_FRAMES = 300
"""Frames of the trace kept for a browser that cannot keep up; older ones are dropped and counted."""

FLOOD = 120
FLOOD_OF_ALL = 2000
WINDOW_S = 0.5
"""More changes than this within a window, which is more than six full wires bring, and the page is told once
in a window until it is quieter: it could not draw them all, and its device has other things to do. So with
very many pages, whose share of ``FLOOD_OF_ALL`` is smaller: the server has other things to do."""

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


@dataclass(slots=True)
class Flow:
    """How much there was to tell a page lately, by a monotonic clock in seconds."""

    clock: Callable[[], float] = time.monotonic
    most: int = FLOOD
    _began: float = 0.0
    _count: int = 0
    _flooded: bool = False

    def came(self) -> None:
        """There is something new for the page."""
        now = self.clock()
        if now - self._began >= WINDOW_S:
            self._flooded = self._count > self.most and now - self._began < 2 * WINDOW_S
            self._began, self._count = now, 0
        self._count += 1

    def pause_s(self) -> float:
        """How long to wait before telling it: nothing unless there is a flood."""
        if self._flooded or self._count > self.most:
            return max(0.0, self._began + WINDOW_S - self.clock())
        return 0.0


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
    _flow: Flow = field(default_factory=Flow)

    def share(self, pages: int) -> None:
        """So many pages are open in all."""
        self._flow.most = min(FLOOD, max(1, FLOOD_OF_ALL // pages))

    def tell(self, diff: Diff) -> None:
        """Newest wins: merged with what has not been sent."""
        self._flow.came()
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
        pause_s = self._flow.pause_s()
        if pause_s:
            await asyncio.sleep(pause_s)
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
