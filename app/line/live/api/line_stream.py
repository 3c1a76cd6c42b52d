"""What ``GET /stream`` sends: changes of the line as they are reported, the same for every program.

A change is found once, by comparing what the API shows of a unit with what it showed before; nothing is
compared while no one reads. A program that reads too slowly, or was away for too long, gets a snapshot in
place of what it missed: no queue grows for it.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import cycle, islice
from math import ceil
from secrets import token_hex
from typing import Any

from app.core.web.api.shape import iso
from app.line.live.admission import Admission
from app.line.live.api.recent_events import PIECE_BYTES, RecentEvents
from app.line.live.api.view import Json, LineView, bus_fields
from app.line.live.screen.diff import put_fields
from app.line.live.state.bus_live import Audience, changed_by
from bus.contract import Update
from bus.instants import Clock, Monotonic, MonotonicClock, monotonic_now

TICK_S = 0.1
TICKS_OF_ALL = 10
"""To compare a long line at once would hold up everything else for tens of milliseconds."""
HEARTBEAT_TICKS = 50
AWAY_S = 60.0
"""For so long after the last program has left, events are noted for its return."""
PAUSE_S = 0.05
"""From one piece to the next for one program: what comes in between goes together."""
SNAPSHOT_S = 1.0
"""A snapshot of this age serves another program: what changed since then follows it."""
MAX_BYTES = 4 * 1024 * 1024
"""Of events kept: for the longest line at four readings a second some ten seconds."""
MAX_OF_ACCOUNT, MAX_OF_ADDRESS = 16, 64
RETRY = b"retry: 2000\n"
"""Milliseconds after which a client connects again; of the first event."""


@dataclass(eq=False, repr=False)
class LineStream:
    """Notes changes while someone reads. ``clock``: Unix time in seconds."""

    _view: LineView
    clock: Clock
    monotonic: MonotonicClock = monotonic_now

    def __post_init__(self) -> None:
        self.admission = Admission(MAX_OF_ACCOUNT, MAX_OF_ADDRESS)
        self._recent = RecentEvents(token_hex(4), MAX_BYTES)
        self._shown: dict[tuple[str, int | None], Json] = {}
        """By bus and unit (None: the bus itself), as last compared; empty while no one reads."""
        self._is_noting = False
        self._keys: list[tuple[str, int | None]] = []
        self._turns: Iterator[tuple[str, int | None]] = iter(())
        self._snapshots: dict[str | None, tuple[Monotonic, int, bytes]] = {}
        self._readers = 0
        self._left_at = self.monotonic()
        self._has_more = asyncio.Event()
        self._is_ending = False
        for name, bus in self._view.live.buses.items():
            bus.subscribe(Audience.STREAM, partial(self._on_updates, name))

    # --- to the programs ------------------------------------------------------------------------------

    @contextmanager
    def reading(self) -> Iterator[None]:
        """While a program reads, and for a while after, changes are noted."""
        self._readers += 1
        if not self._is_noting:
            self._take_up()
        try:
            yield
        finally:
            self._readers -= 1
            self._left_at = self.monotonic()

    async def pieces(
        self, bus: str | None, last_event_id: str = "", seconds: float | None = None
    ) -> AsyncIterator[bytes]:
        """Yield all events after the one of this id, or a snapshot and all after it, for ``seconds`` or
        until the server ends. ``bus``: only of this one and of the site.
        """
        loop = asyncio.get_running_loop()
        end = None if seconds is None else loop.time() + seconds
        yield RETRY
        number = self._recent.number_of(last_event_id)
        while not self._is_ending and (end is None or loop.time() < end):
            has_more = self._has_more
            if number is None or not self._recent.has_all_after(number):
                number, text = self._snapshot(bus)
            else:
                number, text = self._recent.after(number, bus)
            for begin in range(0, len(text), PIECE_BYTES):
                yield text[begin : begin + PIECE_BYTES]
            if number == self._recent.newest:
                with suppress(TimeoutError):
                    async with asyncio.timeout_at(end):
                        await has_more.wait()
            await asyncio.sleep(PAUSE_S)

    def end(self) -> None:
        """The server ends, and so does every response."""
        self._is_ending = True
        self._has_more.set()

    def _snapshot(self, bus: str | None) -> tuple[int, bytes]:
        made_at, number, text = self._snapshots.get(bus, (Monotonic(0.0), -1, b""))
        now = self.monotonic()
        if now - made_at > SNAPSHOT_S or not self._recent.has_all_after(number):
            number = self._recent.newest
            text = self._recent.text("snapshot", number, self._view.line(self.clock(), bus))
            self._snapshots[bus] = now, number, text
        return number, text

    # --- what changes ---------------------------------------------------------------------------------

    async def follow(self) -> None:
        """Run until canceled: what has aged, and the heartbeats."""
        ticks = 0
        while True:
            await asyncio.sleep(TICK_S)
            ticks += 1
            self.tick(with_heartbeat=ticks % HEARTBEAT_TICKS == 0)

    def tick(self, *, with_heartbeat: bool) -> None:
        """What has changed without a report: a response that is overdue, a block."""
        if self._is_noting and not self._readers and self.monotonic() - self._left_at > AWAY_S:
            self._is_noting, self._shown, self._snapshots = False, {}, {}
            self._recent.interrupt()
        if self._is_noting:
            for bus, unit in islice(self._turns, ceil(len(self._keys) / TICKS_OF_ALL)):
                self._compare(bus, unit)
        if with_heartbeat:
            self.add("heartbeat", None, lambda: {"time": iso(self.clock())})

    def add(self, kind: str, bus: str | None, make: Callable[[], Any]) -> None:
        """One more event, made where someone reads. ``bus``: None for the site."""
        if self._is_noting:
            self._recent.add(kind, bus, make())
            self._wake()

    def _take_up(self) -> None:
        """Begin to compare what is shown of the buses."""
        self._is_noting = True
        buses = self._view.live.buses
        self._keys = [(name, unit) for name, bus in buses.items() for unit in (None, *bus.units)]
        self._turns = cycle(self._keys)
        self._shown = {key: self._fields(*key) for key in self._keys}
        self._snapshots = {}

    def _wake(self) -> None:
        self._has_more.set()
        self._has_more = asyncio.Event()

    def _on_updates(self, bus_name: str, updates: Sequence[Update]) -> None:
        if self._is_noting:
            units, is_bus = changed_by(self._view.live.buses[bus_name], updates)
            for unit in (None, *units) if is_bus else units:
                self._compare(bus_name, unit)

    def _compare(self, bus_name: str, unit: int | None) -> None:
        key = bus_name, unit
        if changed := put_fields(self._shown, key, self._fields(*key)):
            self.add("change", bus_name, lambda: {"bus": bus_name, "unit": unit} | changed[key])

    def _fields(self, bus_name: str, unit: int | None) -> Json:
        if unit is None:
            return bus_fields(self._view.live.buses[bus_name])
        fields = self._view.unit(bus_name, unit, self.clock())
        # It grows on its own, and ``read_at`` does not.
        del fields["age_ms"]
        return fields
