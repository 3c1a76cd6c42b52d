"""History as the rest of the app uses it: it stores readings and returns results of queries."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import structlog

from app.errors import StoreError
from app.line.history import tables
from app.line.history.query import QueryResult, SeriesQuery, run_query
from app.line.history.recorder import Tail
from app.line.history.series.runs import SECOND, micros
from app.line.history.series.values import Interval
from app.line.history.settings import HistorySettings
from app.line.history.status import HistoryStatus
from app.line.history.tables import BlockKey
from app.line.history.writer import Writer
from app.people.audit.entry import EventKind
from bus.contract import Update
from bus.instants import UnixTime, unix_now
from bus.messages import Message
from bus.settings import BusSettings

FILE = "history.db"
T = TypeVar("T")
log = structlog.get_logger()


FaultSubscriber = Callable[[EventKind, Message, UnixTime], None]
"""A function that is called with the kind of event, what happened, and the Unix time."""


class History:
    """The history of a site, which stores readings in a folder and runs queries on them. Opening never fails:
    :attr:`status` shows when a store cannot be used. Subscribers are called on the event loop that called
    :meth:`start`. ``shift_starts``: minutes after midnight in ``time_zone``, for the spans that the trends
    page offers."""

    def __init__(
        self,
        folder: Path,
        buses: Iterable[BusSettings] = (),
        kept: HistorySettings | None = None,
        time_zone: str = "UTC",
        shift_starts: Sequence[int] = (),
    ) -> None:
        self.path = folder / FILE
        self.buses = {bus.name: bus for bus in buses}
        self.time_zone, self.shift_starts = time_zone, shift_starts
        self._fault_subscribers: list[FaultSubscriber] = []
        self._writer = Writer(
            self.path, kept or HistorySettings(), self._publish_fault, buses=[*self.buses.values()]
        )

    def on_fault(self, subscriber: FaultSubscriber) -> None:
        """Call ``subscriber`` when this machine's clock was stepped or something stored cannot be read."""
        self._fault_subscribers.append(subscriber)

    def _publish_fault(self, kind: EventKind, what: Message) -> None:
        """Tell the subscribers, on the event loop, of a fault that the writer's thread has met."""
        for subscriber in self._fault_subscribers:
            self._loop.call_soon_threadsafe(subscriber, kind, what, unix_now())

    def start(self) -> None:
        """Open the store and begin to write."""
        self._loop = asyncio.get_running_loop()
        self._writer.start()

    def close(self) -> None:
        """Write what was appended to the disk, then close the store."""
        self._writer.close()

    def append(self, bus: str, updates: Sequence[Update]) -> None:
        """Queue updates of a worker for storing, without waiting."""
        self._writer.enqueue((bus, updates))

    @property
    def status(self) -> HistoryStatus:
        """Whether history is stored, and if not, why."""
        return self._writer.status

    async def query(self, queries: Sequence[SeriesQuery]) -> list[QueryResult]:
        """Read the series of each query. Raise StoreError when the store cannot be read."""
        found = await self.read(lambda c, tail: [run_query(c, tail, one) for one in queries])
        for each in found:
            self.report(each.damaged)
        return found

    async def newest(self, bus: str) -> UnixTime | None:
        """Return the time of the newest stored reading of a bus; None if there is none that can be read."""

        def read(connection: tables.StoreConnection, tail: Tail) -> int | None:
            keys = tables.units_of(connection, bus)
            stored = [tables.newest_reading(connection, key) for key in keys]
            waiting = [run[1] for unit, run in tail.everything() if unit in keys]
            return max((at for at in (*stored, *waiting) if at is not None), default=None)

        try:
            at = await self.read(read)
        except StoreError as error:
            log.warning("the end of the history cannot be read", bus=bus, why=str(error))
            return None
        return None if at is None else seconds(at)

    def report(self, damaged: Iterable[BlockKey]) -> None:
        """Let the writer set aside blocks that could not be read."""
        self._writer.report(damaged)

    async def read(self, work: Callable[[tables.StoreConnection, Tail], T], *, costly: bool = False) -> T:
        """Run ``work`` with a read-only connection and the tail, in a thread; ``costly`` work has threads of
        its own. Raise StoreError."""
        tail, database = self._writer.tail, self._writer.database
        try:
            read = database.read_costly if costly else database.read
            return await read(lambda connection: work(connection, tail))
        except ValueError as error:
            raise StoreError(Message.of("store_damaged", path=str(self.path), error=str(error))) from error


def seconds(at: int) -> UnixTime:
    """Convert µs to seconds since the epoch."""
    return UnixTime(at / SECOND)


MAX_SPANS = 50_000
"""The most spans of bits over a time; if they change more often they are not read."""
StatusSpan = tuple[UnixTime, UnixTime, int]


async def status_words(
    history: History, bus: str, unit: int, start: UnixTime, end: UnixTime
) -> list[StatusSpan]:
    """Return spans (Unix time, seconds) with their bits, ST2 * 256 + ST1, in order. Raise StoreError."""
    wanted = micros(start), micros(end)

    def read(connection: tables.StoreConnection, tail: Tail) -> list[Interval]:
        key = tables.find_unit(connection, bus, unit)
        if key is None:
            return []
        recent = [Interval(run.at, run.until, run.word) for run in tail.runs(key, *wanted)]
        if tables.count_bits(connection, key, *wanted) > MAX_SPANS:
            return recent
        return tables.bits_around(connection, [key], *wanted)[key] + recent

    spans = sorted(await history.read(read))
    return [(seconds(span.at), seconds(span.until), span.word) for span in spans]
