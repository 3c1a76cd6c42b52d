"""One browser's socket: it gets the newest values, never a queue.

What changed while the socket was busy goes together as one update, so a slow browser is always shown the
present and costs no more than a few references: all who missed the same share what it is made of.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from app.live.screen import Groups

MOST_FRAMES = 300
"""Frames of the trace kept for a browser that cannot keep up; older ones are dropped and counted."""

FLOOD = 60
WINDOW_S = 0.25
"""More changed units than this within a window, which is more than six full wires bring, and the page is
told once in a window until it is quieter: it could not draw them all, its device has other things to do."""

FEW_PAGES = 40
MOST_TOLD_S = 1000
"""With more pages than a few, none is told again before its share of so many messages a second: the server
has other things to do. 200 pages are told five times a second, 40 and fewer of every single answer."""

MOST_WAITING = 64
"""Changes that wait for a slow browser before they are made one."""

encode = msgspec.json.Encoder().encode


@dataclass(eq=False, slots=True)
class Diff:
    """What changed between the numbers ``before`` and ``after``, the same object for all of a language."""

    before: int
    after: int
    at: float
    groups: Groups
    _text: str = ""
    _since: dict[int, Diff] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """Encoded once, whoever it goes to."""
        if not self._text:
            message = {
                "is": "diff",
                "p": self.before,
                "n": self.after,
                "t": round(self.at, 3),
                "f": self.groups,
            }
            self._text = encode(message).decode()
        return self._text

    def after_all(self, earlier: Sequence[Diff]) -> Diff:
        """One that says what ``earlier``, which led to this one, and this one said; made once for all who
        missed the same."""
        if not earlier:
            return self
        before = earlier[0].before
        if before not in self._since:
            self._since[before] = Diff(before, self.after, self.at, _merged([*earlier, self]))
        return self._since[before]


@dataclass(slots=True)
class Flow:
    """How much there was to tell a page lately, by a monotonic clock in seconds."""

    clock: Callable[[], float] = time.monotonic
    gap_s: float = 0.0
    _began: float = 0.0
    _count: int = 0
    _flooded: bool = False
    _told_at: float = -math.inf

    def came(self, units: int = 1) -> None:
        """There is something new of so many units for the page."""
        now = self.clock()
        if now - self._began >= WINDOW_S:
            self._flooded = self._count > FLOOD and now - self._began < 2 * WINDOW_S
            self._began, self._count = now, 0
        self._count += units

    def pause_s(self) -> float:
        """How long to wait before telling it again: nothing unless there is a flood, or very many pages."""
        flooded = self._flooded or self._count > FLOOD
        gap_s = max(self.gap_s, WINDOW_S) if flooded else self.gap_s
        return max(0.0, self._told_at + gap_s - self.clock())

    def told(self) -> None:
        """It was told everything."""
        self._told_at = self.clock()


@dataclass(eq=False, slots=True)
class Browser:
    """What one open page wants and has not had yet. ``units``: the pages' own, for the worker's schedule."""

    name: str
    role: str
    language: str
    units: frozenset[tuple[str, int]] = frozenset()
    trace: str = ""
    _waiting: list[Diff] = field(default_factory=list)
    _messages: deque[str] = field(default_factory=deque)
    _frames: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_FRAMES))
    _wake: asyncio.Event = field(default_factory=asyncio.Event)
    _flow: Flow = field(default_factory=Flow)

    def share(self, pages: int) -> None:
        """So many pages are open in all."""
        self._flow.gap_s = pages / MOST_TOLD_S if pages > FEW_PAGES else 0.0

    def tell(self, diff: Diff) -> None:
        """Newest wins: it goes together with what has not been sent."""
        self._flow.came(len(diff.groups) or 1)
        if len(self._waiting) >= MOST_WAITING:
            self._waiting = [diff.after_all(self._waiting)]
        else:
            self._waiting.append(diff)
        self._wake.set()

    def say(self, message: dict[str, Any]) -> None:
        """A message of its own, before any diff: snapshot. It makes what was pending worthless."""
        self._waiting.clear()
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
        self._flow.told()
        texts = list(self._messages)
        self._messages.clear()
        if self._waiting:
            *earlier, newest = self._waiting
            self._waiting.clear()
            texts.append(newest.after_all(earlier).text)
        if self._frames:
            texts.append(encode({"is": "frames", "frames": list(self._frames)}).decode())
            self._frames.clear()
        return texts


def _merged(diffs: Sequence[Diff]) -> Groups:
    groups: Groups = {}
    for diff in diffs:
        for group, fields in diff.groups.items():
            groups.setdefault(group, {}).update(fields)
    return groups
