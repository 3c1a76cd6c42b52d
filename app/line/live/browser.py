"""An open page, which gets the newest values and never a queue.

Changes while its socket is busy go together as one update. A slow browser is always shown the present, and
costs a few references: all that missed the same updates share one merged update.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import msgspec

from app.line.live.fields import Groups, merge_groups
from bus.instants import UnixTime

MAX_FRAMES = 300
"""Frames of the trace kept for a browser that cannot keep up; older ones are dropped and counted."""

MAX_WAITING = 64
"""The most changes that wait for a slow browser before they are merged into one."""

encode = msgspec.json.Encoder().encode


@dataclass(eq=False)
class Diff:
    """The changes between numbers ``before`` and ``after``: one object for all pages of a language."""

    before: int
    after: int
    at: UnixTime
    groups: Groups
    _since: dict[int, Diff] = field(default_factory=dict)

    @cached_property
    def text(self) -> str:
        """The diff in JSON, encoded once for all browsers."""
        message = {"is": "diff", "p": self.before, "n": self.after, "t": round(self.at, 3), "f": self.groups}
        return encode(message).decode()

    def after_all(self, earlier: Sequence[Diff]) -> Diff:
        """Return this diff and the ``earlier`` ones as one, made once for all browsers that missed the same
        diffs."""
        if not earlier:
            return self
        before = earlier[0].before
        if before not in self._since:
            groups = merge_groups({}, *(diff.groups for diff in (*earlier, self)))
            self._since[before] = Diff(before, self.after, self.at, groups)
        return self._since[before]


@dataclass(eq=False)
class LinesUpdate:
    """Changed fields of lines: one object for all pages of a language that follow them."""

    groups: Groups

    @cached_property
    def text(self) -> str:
        """The update in JSON, encoded once for all browsers."""
        return encode({"is": "lines", "f": self.groups}).decode()


@dataclass(eq=False, slots=True)
class Browser:
    """The messages that wait for one open page. ``units``: the units it shows, for the worker's schedule."""

    name: str
    role: str
    language: str
    units: frozenset[tuple[str, int]] = frozenset()
    trace: str = ""
    lines: bool = False
    """Whether it shows the lines of all servers."""
    _waiting: list[Diff] = field(default_factory=list)
    _snapshot: dict[str, Any] | None = None
    _frames: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MAX_FRAMES))
    _lines: LinesUpdate | None = None
    _wake: asyncio.Event = field(default_factory=asyncio.Event)

    def send_diff(self, diff: Diff) -> None:
        """Send a diff, merged with diffs that have not been sent yet."""
        if len(self._waiting) >= MAX_WAITING:
            self._waiting = [diff.after_all(self._waiting)]
        else:
            self._waiting.append(diff)
        self._wake.set()

    def send(self, message: dict[str, Any]) -> None:
        """Send a snapshot, before any diff. It replaces pending messages and is encoded when it is sent, so
        that repeated requests yield one."""
        self._waiting.clear()
        self._snapshot = message
        self._wake.set()

    def show_frames(self, frames: list[dict[str, Any]]) -> None:
        """Send frames to a browser that follows the trace."""
        self._frames.extend(frames)
        self._wake.set()

    def show_lines(self, update: LinesUpdate) -> None:
        """Send changed fields of lines, merged with those that have not been sent yet."""
        held = self._lines
        self._lines = update if held is None else LinesUpdate(merge_groups({}, held.groups, update.groups))
        self._wake.set()

    async def next(self) -> list[str]:
        """Wait for messages; return all, in order. A second call means that the first ones were sent."""
        await self._wake.wait()
        self._wake.clear()
        texts = [] if self._snapshot is None else [encode(self._snapshot).decode()]
        self._snapshot = None
        if self._waiting:
            *earlier, newest = self._waiting
            self._waiting.clear()
            texts.append(newest.after_all(earlier).text)
        if self._lines is not None:
            texts.append(self._lines.text)
            self._lines = None
        if self._frames:
            texts.append(encode({"is": "frames", "frames": list(self._frames)}).decode())
            self._frames.clear()
        return texts
