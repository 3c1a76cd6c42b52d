"""Updates that the app has not confirmed yet: in order, numbered as they are sent, bounded. No I/O.

A batch gets its number when it is made. After a lost connection everything that the app does not have
(``Welcome.seq``) goes back to the front and is numbered from there, so the app never sees a gap.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterable
from itertools import chain

from msgspec.structs import replace

from bus.contract import MAX_UPDATES, Batch, BusFigures, Frames, Progress, Reading, Result, Update
from bus.instants import UnixTime

MAX_READINGS = 30_000
"""13 minutes of one bus at 9600 baud (38.4 readings a second)."""
MAX_OTHERS = 10_000
FRAMES_OF_ONE = 10
ENOUGH_WAITING = 1_000
"""With so much waiting, what is of the moment only is not queued as well."""

Passing = Progress | BusFigures | Frames
"""Of the moment only: worth nothing later."""


class Outbox:
    """``put`` in, ``next_batch`` out, ``delivered`` forgets.

    In the order of time: ``_stripped`` and ``_sent`` are batches without the app's word for them,
    ``_old`` and ``_waiting`` are updates that were never sent. Stripped and old are what is left where
    readings had to be dropped.
    """

    def __init__(self, most_readings: int = MAX_READINGS, most_others: int = MAX_OTHERS) -> None:
        self._most_readings = most_readings
        self._most_others = most_others
        self._stripped: deque[Batch] = deque()
        self._sent: deque[Batch] = deque()
        self._old: deque[Update] = deque()
        self._waiting: deque[Update] = deque()
        self._readings = 0
        self._others = 0
        self.seq = 0
        """The number of the last batch made."""
        self._backlog = 0
        self.connected = False
        self.lost = 0
        """Updates dropped since the start because the app was away too long."""
        self.filled = asyncio.Event()

    def __len__(self) -> int:
        return self._readings + self._others

    def put(self, updates: Iterable[Update]) -> None:
        for update in updates:
            if isinstance(update, Passing) and not (self.connected and len(self._waiting) < ENOUGH_WAITING):
                continue
            self._waiting.append(update)
            self._count(update, 1)
        self._keep_bounds()
        self.filled.set()

    def disconnected(self) -> None:
        self.connected = False

    def resume(self, delivered: int, *, oldest: UnixTime = UnixTime(0.0)) -> None:
        """The app is back and has every batch up to ``delivered``; all else is backlog now, except what is
        from before ``oldest`` (seconds since the epoch), which it would refuse."""
        self.delivered(delivered)
        batches = chain(self._stripped, self._sent)
        updates = chain(chain.from_iterable(batch.updates for batch in batches), self._old, self._waiting)
        lasting = [update for update in updates if not isinstance(update, Passing)]
        kept: deque[Update] = deque(update for update in lasting if update.at >= oldest)
        self.lost += len(lasting) - len(kept)
        for queue in (self._stripped, self._sent, self._old):
            queue.clear()
        self._waiting = kept
        self._readings = self._others = 0
        for update in kept:
            self._count(update, 1)
        self.seq = delivered
        self._backlog = len(kept)
        self.connected = True

    def next_batch(self, at: UnixTime) -> Batch | None:
        """The next to send, at epoch second ``at``; None when nothing waits."""
        updates = self._take()
        if not updates:
            self.filled.clear()
            return None
        live = self._backlog == 0
        self._backlog = max(0, self._backlog - len(updates))
        self.seq += 1
        batch = Batch(seq=self.seq, sent_at=at, updates=updates, live=live)
        self._keep_until_confirmed(batch)
        return batch

    def delivered(self, seq: int) -> None:
        """The app has every batch up to ``seq``."""
        for queue in (self._stripped, self._sent):
            while queue and queue[0].seq <= seq:
                for update in queue.popleft().updates:
                    self._count(update, -1)

    def _take(self) -> list[Update]:
        wanted = min(MAX_UPDATES, self._backlog or MAX_UPDATES)
        updates: list[Update] = []
        for queue in (self._old, self._waiting):
            while queue and len(updates) < wanted:
                updates.append(queue.popleft())
        return updates

    def _keep_until_confirmed(self, batch: Batch) -> None:
        """Without what is of the moment: an app that never confirms must not fill the memory."""
        self._others -= sum(_weight(update) for update in batch.updates if isinstance(update, Passing))
        lasting = [update for update in batch.updates if not isinstance(update, Passing)]
        if lasting:
            self._sent.append(replace(batch, updates=lasting))

    def _count(self, update: Update, step: int) -> None:
        if isinstance(update, Reading):
            self._readings += step
        else:
            self._others += step * _weight(update)

    def _keep_bounds(self) -> None:
        while self._readings > self._most_readings:
            if self._sent:
                self._strip(self._sent.popleft())
            else:
                self._drop_first_reading()
        while self._others > self._most_others:
            self._drop_first_other()

    def _strip(self, batch: Batch) -> None:
        others: list[Update] = [update for update in batch.updates if not isinstance(update, Reading)]
        gone = len(batch.updates) - len(others)
        self._readings -= gone
        self.lost += gone
        if others:
            self._stripped.append(replace(batch, updates=others))

    def _drop_first_reading(self) -> None:
        """The oldest reading goes; what is none keeps its place before all that follows."""
        update = self._waiting.popleft()
        if isinstance(update, Reading):
            self._readings -= 1
            self.lost += 1
            self._backlog = max(0, self._backlog - 1)
        else:
            self._old.append(update)

    def _drop_first_other(self) -> None:
        """Far more news than any line makes: the oldest goes, wherever it is."""
        for queue in (self._stripped, self._sent):
            if queue:
                batch = queue.popleft()
                for update in batch.updates:
                    self._count(update, -1)
                self.lost += len(batch.updates)
                return
        update = (self._old or self._waiting).popleft()
        self._count(update, -1)
        self.lost += 1
        self._backlog = max(0, self._backlog - 1)


def _weight(update: Update) -> int:
    """Of an update that is no reading: a result with a piece of the trace is as large as many."""
    return 1 + len(update.frames) // FRAMES_OF_ONE if isinstance(update, Result | Frames) else 1
