"""The one thread that writes the store; it survives and reports every disk failure."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import structlog

from app.core.database import Database
from app.core.database.connection import size_of
from app.core.database.files import free_bytes
from app.core.database.migration import proves_intact, put_aside
from app.core.web.shape import iso
from app.errors import DamagedStoreError, StoreError, system_error
from app.line.history import tables
from app.line.history.recorder import Delivery, FoundDamage, Recorder, Tail, compact, set_aside
from app.line.history.report import basis_of, is_sealed, work_out
from app.line.history.series.runs import DAY, HOUR, MINUTE, SECOND, micros
from app.line.history.settings import HistorySettings
from app.line.history.status import (
    NOTICES,
    DiskReserve,
    HistoryStatus,
    StoreState,
    damage_message,
    space,
    store_message,
)
from app.line.history.tables import BlockKey, DamagedBlock
from app.people.audit.entry import EventKind
from bus.instants import ClockWatch, Monotonic, UnixTime, monotonic_now, unix_now
from bus.messages import Message, in_english, number
from bus.settings import BusSettings

COMMIT_EVERY_S = 0.5
"""The seconds between commits: a power failure loses the readings of this time, and of the commit."""
BUSY_S = 0.2
"""The seconds that folding, and then upkeep, may take between two commits."""
END_S = 1.0
"""The seconds that folding may take at the end; the rest stays in the journal."""
RETRY_S = 10.0
LOOK_EVERY_S = 5.0
GIVE_UP_EVERY_S = 600.0
MAX_WAITING = 500_000
"""The most updates kept in memory while the store cannot be written; then the oldest are lost."""

MAX_REPORTED = 1000
REPLACE_EVERY_S = 86_400.0
"""The seconds within which a store that is damaged again is not replaced: the machine is at fault."""
SHOWN_FOR = 7 * DAY
"""The time for which pages show damage, µs; its event stays."""

MIGRATIONS = Path(__file__).parent / "migrations"
log = structlog.get_logger()
OnFault = Callable[[EventKind, Message], None]
"""A function that is called on the writer's thread with the kind and the text of an event."""


SETTLED_S = 3600.0
"""The seconds after a start or a clock step in which nothing is given up for its age, since the clock may be
wrong."""
LATE = 10 * MINUTE
"""The time for which workers buffer while the app is away, µs: earlier hours are complete."""
MAX_DROPPED = 50
"""The most blocks that one transaction deletes."""
MAX_PAGES = 2000
"""The most pages that are given back to the disk at a time."""
FIGURES_S = 0.05
"""The seconds for figures of hours between two commits; those of one unit and hour may take longer."""
FIGURES_EVERY_S = 20.0
"""The seconds after the start, and between two searches for hours that have no figures."""
LOOK_BACK = 92 * DAY
"""The span of the first search, µs: the longest report."""


class Upkeep:
    """The upkeep between two commits, for a short time each: it packs hours, computes their figures and gives
    up old readings."""

    def __init__(
        self,
        database: Database,
        kept: HistorySettings,
        reserve: DiskReserve,
        on_damage: FoundDamage,
        buses: Sequence[BusSettings] = (),
    ) -> None:
        self._database = database
        self._buses = buses
        self._kept = kept
        self._reserve = reserve
        self._on_damage = on_damage
        self._settled_at = monotonic_now() + SETTLED_S
        self._to_sweep = True
        self._search_at = monotonic_now() + FIGURES_EVERY_S
        self._search: Iterator[tuple[BusSettings, int, int] | None] = iter(())
        self._look_back = LOOK_BACK

    def clock_stepped(self, now: int) -> None:
        """Give up nothing for a while after a clock step; ``now`` in µs, by the new clock."""
        self._settled_at = monotonic_now() + SETTLED_S
        self._database.write_now(lambda c: tables.correct_raw_from(c, now))

    def look(self) -> tuple[int, StoreState]:
        """Return the free bytes on the disk of the store, and the state that follows."""
        free = free_bytes(self._database.path.parent)
        return free, space(free, self._reserve)

    def compact(self, now: int, deadline: Monotonic) -> None:
        """Pack hours that are over until ``deadline`` (monotonic seconds)."""
        before = now - now % HOUR
        if now - before < LATE:
            before -= HOUR
        while monotonic_now() < deadline:
            found = self._database.read_now(lambda c: tables.next_to_compact(c, before))
            if found is None:
                return
            try:
                self._database.write_now(lambda c, found=found: compact(c, *found))  # type: ignore[misc]
            except DamagedBlock as damaged:
                set_aside(self._database, damaged.block, self._on_damage)

    def work_out(self, now: int, deadline: Monotonic) -> None:
        """Store the figures of packed hours that have none until ``deadline`` (monotonic seconds)."""
        if monotonic_now() >= self._search_at:
            self._search_at = Monotonic(math.inf)
            self._search = self._unworked(now - now % HOUR)
        for found in self._search:
            if found is not None:
                self._work_out_one(*found)
            if monotonic_now() >= deadline:
                return

    def _work_out_one(self, bus: BusSettings, unit: int, hour: int) -> None:
        try:
            self._database.write_now(lambda c: work_out(c, bus, unit, hour))
        except StoreError:
            raise
        except Exception:
            # A report reads this hour from its readings; storing the others matters more.
            log.exception("figures", bus=bus.name, unit=unit, hour=hour)

    def _unworked(self, newest: int) -> Iterator[tuple[BusSettings, int, int] | None]:
        """Yield each unit and hour without figures, the newest hours of a bus first, and None after each
        hour."""
        read = self._database.read_now
        oldest, _ = read(tables.extent) or (newest, newest)
        hours = range(newest, max(oldest - HOUR, newest - self._look_back), -HOUR)
        for bus in self._buses:
            bases = read(lambda c, bus=bus: {unit.id: basis_of(c, bus, unit.id) for unit in bus.unit})  # type: ignore[misc]
            for hour in hours:
                packed = read(lambda c, bus=bus, hour=hour: tables.packed_units(c, bus.name, hour))  # type: ignore[misc]
                for unit, figures in packed.items():
                    if unit in bases and not is_sealed(figures or b"", bases[unit]):
                        yield bus, unit, hour
                yield None
        self._look_back = DAY
        self._search_at = monotonic_now() + FIGURES_EVERY_S

    def give_up_old(self, now: int) -> None:
        """Mark readings past their retention as given up; :meth:`sweep` then deletes them."""
        if monotonic_now() < self._settled_at:
            return
        horizon = now - self._kept.raw_days * DAY
        self._give_up_before(horizon - horizon % HOUR)
        self._database.write_now(lambda c: tables.drop_rollups(c, now - self._kept.years * 365 * DAY))

    def trim(self, now: int) -> None:
        """Give up the oldest hour of readings for lack of space, but never the last hour."""
        oldest = self._database.read_now(tables.oldest_packed)
        if oldest is not None and oldest - oldest % HOUR + HOUR <= now - HOUR:
            self._give_up_before(oldest - oldest % HOUR + HOUR)

    def sweep(self, deadline: Monotonic) -> None:
        """Delete readings that were given up until ``deadline`` (monotonic seconds)."""
        while self._to_sweep and monotonic_now() < deadline:
            dropped = self._database.write_now(lambda c: tables.drop_raw(c, tables.raw_from(c), MAX_DROPPED))
            self._to_sweep = dropped == MAX_DROPPED
            self._database.give_back(MAX_PAGES)

    def _give_up_before(self, horizon: int) -> None:
        def move(connection: tables.StoreConnection) -> bool:
            further = horizon > tables.raw_from(connection)
            if further:
                tables.write_raw_from(connection, horizon)
            return further

        self._to_sweep = self._database.write_now(move) or self._to_sweep


@dataclass(slots=True)
class OpenStore:
    """An open store and its writing parts."""

    database: Database
    recorder: Recorder
    upkeep: Upkeep


class Writer:
    """The owner of the store, with its thread. Readers see the ``tail`` beside the store."""

    def __init__(
        self,
        path: Path,
        kept: HistorySettings,
        on_fault: OnFault,
        reserve: DiskReserve | None = None,
        buses: Sequence[BusSettings] = (),
    ) -> None:
        self._path = path
        self._kept = kept
        self._reserve = reserve or DiskReserve()
        self._buses = buses
        self._on_fault = on_fault
        self._on_damage: FoundDamage = partial(on_fault, "server")
        self._reported: deque[BlockKey] = deque(maxlen=MAX_REPORTED)
        self._is_torn = False
        """Whether pages are damaged, so that the store is to be replaced."""
        self._replaced_at = Monotonic(-math.inf)
        self.tail = Tail()
        self._queue: deque[Delivery] = deque()
        self._waiting = 0
        self._taken = 0
        self._lost = 0
        self._open: OpenStore | None = None
        self._writable = False
        self._status = HistoryStatus(since=unix_now())
        self._space: StoreState = "ok"
        self._clock = ClockWatch(unix_now(), monotonic_now())
        self._retry_at = self._look_at = self._give_up_at = Monotonic(0.0)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="history-writer", daemon=True)

    def start(self) -> None:
        """Open the store if possible, and start the thread."""
        self._guard(self._open_store)
        self._thread.start()

    def close(self) -> None:
        """Write the waiting deliveries to the disk, then close the store."""
        self._ending.set()
        self._thread.join()

    def enqueue(self, delivery: Delivery) -> None:
        """Queue a delivery without waiting; only the event loop may call it."""
        self._queue.append(delivery)
        self._waiting += len(delivery[1])
        while self._waiting - self._taken > MAX_WAITING:
            try:
                lost = len(self._queue.popleft()[1])
            except IndexError:
                return
            self._lost += lost
            self._waiting -= lost

    def report(self, damaged: Iterable[BlockKey]) -> None:
        """Queue unreadable blocks to be set aside; any thread may call this."""
        self._reported.extend(damaged)

    @property
    def status(self) -> HistoryStatus:
        message = self._status.message or damage_message(self._status, iso)
        return replace(self._status, message=message, waiting=self._waiting - self._taken, lost=self._lost)

    @property
    def database(self) -> Database:
        """The store for readers. Raises StoreError with the reason if it cannot be used."""
        if self._open is None:
            raise StoreError(self._status.message or NOTICES["failed"])
        return self._open.database

    # The methods from here on run on the writer's thread.

    def _run(self) -> None:
        took = 0.0
        while not self._ending.wait(max(0.0, COMMIT_EVERY_S - took)):
            began = monotonic_now()
            self._guard(self._tick)
            took = monotonic_now() - began
        self._guard(self._end)

    def _guard(self, work: Callable[[], None]) -> None:
        """Run ``work``; after a failure continue without the store for a while."""
        try:
            work()
        except DamagedStoreError as error:
            log.error("history", damaged=str(error))
            self._is_torn = monotonic_now() - self._replaced_at >= REPLACE_EVERY_S
            self._fail(error.message)
        except StoreError as error:
            self._fail(error.message)
        except (ValueError, OSError) as error:
            self._fail(system_error(error))
        except Exception as error:
            log.exception("history")
            self._fail(Message.of("system_error", error=f"{type(error).__name__}: {error}"))

    def _tick(self) -> None:
        self._watch_clock()
        if not self._writable:
            if monotonic_now() < self._retry_at and not self._is_torn:
                return
            self._open_store()
        self._watch_disk()
        if self._space == "paused":
            # Nothing is written, and the space of deleted readings goes back to the disk.
            assert self._open is not None
            self._open.upkeep.sweep(monotonic_now() + BUSY_S)
        else:
            self._store()

    def _store(self) -> None:
        opened = self._open
        assert opened is not None
        self._commit(opened.recorder)
        with suppress(IndexError):
            set_aside(opened.database, self._reported.popleft(), self._on_damage)
        now = micros(unix_now())
        opened.recorder.fold(now, monotonic_now() + BUSY_S)
        deadline = monotonic_now() + BUSY_S
        opened.upkeep.sweep(deadline)
        opened.upkeep.compact(now, deadline)
        opened.upkeep.work_out(now, monotonic_now() + FIGURES_S)
        if monotonic_now() >= self._give_up_at:
            self._give_up_at = monotonic_now() + GIVE_UP_EVERY_S
            opened.upkeep.give_up_old(now)

    def _commit(self, recorder: Recorder) -> None:
        """Write the waiting deliveries; they stay in the queue if that fails."""
        deliveries: list[Delivery] = []
        with suppress(IndexError):
            for _ in range(len(self._queue)):
                deliveries.append(self._queue.popleft())
        try:
            if deliveries:
                recorder.commit(deliveries)
        except BaseException:
            self._queue.extendleft(reversed(deliveries))
            raise
        self._taken += sum(len(updates) for _, updates in deliveries)

    def _end(self) -> None:
        try:
            if self._open is not None and self._writable and self._space != "paused":
                self._commit(self._open.recorder)
                self._open.recorder.fold_everything(monotonic_now() + END_S)
        finally:
            if self._open is not None:
                self._open.database.close()

    def _open_store(self) -> None:
        """Open the store and load its journal into the tail. Raise StoreError."""
        aside = self._put_aside_if_torn()
        database = Database(self._path, MIGRATIONS)
        recorder = Recorder(database, self.tail, self._on_damage)
        try:
            # Writing the first row shows whether the store can be written.
            database.write_now(lambda c: tables.correct_raw_from(c, micros(unix_now())))
            recorder.replay()
            if aside:
                database.write_now(lambda c: tables.note_replaced(c, aside, micros(unix_now())))
        except BaseException:
            database.close()
            raise
        upkeep = Upkeep(database, self._kept, self._reserve, self._on_damage, self._buses)
        before, self._open = self._open, OpenStore(database, recorder, upkeep)
        self._writable, self._look_at = True, Monotonic(0.0)
        if before is not None:
            before.database.close()
        if aside:
            self._on_damage(Message.of("event_history_put_aside", file=aside))

    def _put_aside_if_torn(self) -> str:
        """Rename a store with damaged pages, and return its new name; empty if it is intact. A second look
        decides, because the first may have met a passing error of the memory or of the disk."""
        if not self._is_torn:
            return ""
        self._is_torn, self._replaced_at = False, monotonic_now()
        opened, self._open = self._open, None
        if opened is not None:
            opened.database.close()
        # The end of the server does not wait for a look at all pages.
        return "" if proves_intact(self._path, self._ending.is_set) else put_aside(self._path).name

    def _fail(self, cause: Message) -> None:
        """Stop writing until the store is opened again; it can still be read."""
        self._writable = False
        self._retry_at = monotonic_now() + RETRY_S
        is_full = False
        with suppress(OSError):
            free = free_bytes(self._path.parent)
            is_full = space(free, self._reserve) == "paused"
            self._status = replace(self._status, free_bytes=free)
        self._set_state("paused" if is_full else "failed", None if is_full else cause)

    def _watch_clock(self) -> None:
        step = self._clock.step(unix_now(), monotonic_now())
        if not step:
            return
        self._on_fault("clock", Message.of("event_app_clock_stepped", step=number(f"{step:+.3f}")))
        if self._open is not None:
            self._open.upkeep.clock_stepped(micros(unix_now()))

    def _watch_disk(self) -> None:
        opened = self._open
        if opened is None or monotonic_now() < self._look_at:
            return
        self._look_at = monotonic_now() + LOOK_EVERY_S
        free, self._space = opened.upkeep.look()
        if self._space in ("scarce", "paused"):
            opened.upkeep.trim(micros(unix_now()))
        read, lately = opened.database.read_now, micros(unix_now()) - SHOWN_FOR
        oldest = read(tables.oldest_raw)
        replaced = read(lambda c: tables.replaced_since(c, lately))
        self._set_state(self._space)
        self._status = replace(
            self._status,
            free_bytes=free,
            size_bytes=read(size_of),
            oldest_reading=None if oldest is None else UnixTime(oldest / SECOND),
            damaged=read(lambda c: tables.damaged_since(c, lately)),
            begun=None if replaced is None else UnixTime(replaced[0] / SECOND),
            put_aside="" if replaced is None else replaced[1],
        )

    def _set_state(self, state: StoreState, cause: Message | None = None) -> None:
        message = store_message(state, cause)
        since = self._status.since if state == self._status.state else unix_now()
        if message != self._status.message:
            log.log(30 if message else 20, "history", state=state, message=in_english(message))
        self._status = replace(self._status, state=state, message=message, cause=cause, since=since)
