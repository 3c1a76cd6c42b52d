"""The open pages of one language: they get the same bytes in the same turn of the loop.

Changes are held back, in a flood or among very many pages, once for all pages, and go together. The number is
that of the last message sent. A page that opens in between gets a snapshot of that number: it
is newer than the number, and the next message repeats some fields.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass, field

from app.line.live.browsers.browser import Browser, Diff
from app.line.live.browsers.flow import Flow
from app.line.live.screen.diff import Groups, merge_groups
from app.line.live.screen.screen import Screen
from bus.instants import Clock


@dataclass(eq=False, slots=True)
class Broadcast:
    """Sends what changes to every open page of one language. ``clock`` returns Unix time in seconds;
    ``page_digest`` identifies what a page is rendered with now."""

    screen: Screen
    clock: Clock
    page_digest: str = ""
    flow: Flow = field(default_factory=Flow)
    browsers: deque[Browser] = field(default_factory=deque)
    """Each browser is the first in its turn: writing to all takes a while; none is always the last."""
    number: int = 0
    _held: Groups = field(default_factory=dict)
    _due: asyncio.TimerHandle | None = None

    def join(self, browser: Browser) -> None:
        """Add a browser; send it a snapshot."""
        self.browsers.append(browser)
        self.send_snapshot(browser)

    def leave(self, browser: Browser) -> None:
        """Remove a browser; drop changes that no page waits for."""
        self.browsers.remove(browser)
        if not self.browsers:
            self._held = {}
            if self._due is not None:
                self._due.cancel()
                self._due = None

    def send_snapshot(self, browser: Browser) -> None:
        """The snapshot, to a page that opened or missed a number."""
        browser.send(
            {
                "is": "snapshot",
                "digest": self.page_digest,
                "n": self.number,
                "t": round(self.clock(), 3),
                "f": self.screen.shown,
            }
        )

    def publish(self, groups: Groups, *, always: bool = False) -> None:
        """Send changed fields, at once or with the next message. ``always``: even when nothing changed."""
        if not self.browsers or not (groups or always):
            return
        self.flow.came(len(groups) or 1)
        if self._due is not None:
            merge_groups(self._held, groups)
        elif pause_s := self.flow.pause_s():
            merge_groups(self._held, groups)
            self._due = asyncio.get_running_loop().call_later(pause_s, self._release)
        else:
            self._publish(groups)

    def _release(self) -> None:
        groups, self._held, self._due = self._held, {}, None
        self._publish(groups)

    def _publish(self, groups: Groups) -> None:
        self.flow.sent()
        diff = Diff(self.number, self.number + 1, self.clock(), groups)
        self.number = diff.after
        self.browsers.rotate()
        for browser in self.browsers:
            browser.send_diff(diff)
