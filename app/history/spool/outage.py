"""What the writer does while the database is away, and until all that was spooled has followed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from app.database import Database
from app.history.intake.updates import Delivery
from app.history.series.runs import SECOND
from app.history.spool.follower import Follower
from app.history.spool.segments import SpoolContents
from app.history.spool.spool import Spool
from app.history.status import HistoryStatus
from app.history.store import tables
from app.history.store.inspection import FoundDamage
from app.web.api.shape import iso
from bus.instants import Clock, Monotonic, UnixTime, unix_now
from bus.messages import Message


class Outage:
    """Only the writer's thread calls it, but for :attr:`status`. ``on_event`` is called with what becomes an
    event."""

    def __init__(self, spool: Spool, on_event: FoundDamage, clock: Clock = unix_now) -> None:
        self._spool, self._on_event, self._clock = spool, on_event, clock
        self._attached: Follower | None = None
        self._follower: Follower | None = None
        self._is_away = False
        self._contents = spool.contents
        self._is_damage_reported = not self._contents.damaged

    def begin(self) -> None:
        """The store cannot be written."""
        if self._is_away:
            return
        self._is_away, self._follower = True, None
        self._spool.note(self._clock())
        self._on_event(Message("event_history_spooling"))
        self._report_damage()

    def keep(self, deliveries: Sequence[Delivery], *, is_repeated: bool) -> None:
        """To the disk. Raises OSError; then they are repeated."""
        lost = self._spool.state.lost
        try:
            self._spool.append(deliveries, is_repeated=is_repeated)
        finally:
            self._contents = self._spool.contents
            if self._spool.state.lost and not lost:
                self._on_event(Message("event_history_spool_full"))

    def attach(self, database: Database, on_damage: FoundDamage) -> None:
        """The store that can be written again; the thread that opens it calls this. Raises StoreError."""
        stored = database.read_now(lambda c: tables.followed(c, self._spool.state.id))
        self._attached = Follower(database, self._spool, on_damage, stored)

    def end(self) -> None:
        """The attached store is written from now on, and followed."""
        assert self._attached is not None
        self._follower, was_away, self._is_away = self._attached, self._is_away, False
        self._spool.close()
        self._follower.begin()
        self._contents = found = self._spool.contents
        self._report_damage()
        if was_away and found.readings:
            since, until = iso(_seconds(found.begin)), iso(_seconds(found.end))
            self._on_event(
                Message.of("event_history_follows", count=found.readings, since=since, until=until)
            )

    def follow(self, deadline: Monotonic) -> None:
        """Store what was spooled until ``deadline`` (monotonic seconds). Raises StoreError, OSError."""
        if self._follower is None or self._spool.state.since is None:
            return
        self._follower.follow(deadline)
        self._contents = self._spool.contents
        if self._contents == SpoolContents():
            self._on_event(Message.of("event_history_followed", lost=self._spool.state.lost))
            self._spool.note(None)

    @property
    def is_following(self) -> bool:
        """Whether stored history lacks what waits here: hours are not packed before they are complete."""
        return self._contents != SpoolContents()

    def newest(self, bus: str) -> UnixTime | None:
        """The time of the newest reading of a bus that waits here."""
        return self._spool.newest(bus)

    def with_spool(self, status: HistoryStatus) -> HistoryStatus:
        """The state of the history with what is here."""
        found, state = self._contents, self._spool.state
        return replace(
            status,
            away_since=state.since if self._is_away else None,
            spooled_readings=found.readings,
            spooled_bytes=found.size,
            spooled_from=_seconds(found.begin) if found.readings else None,
            spooled_to=_seconds(found.end) if found.readings else None,
            spool_lost=state.lost,
        )

    def _report_damage(self) -> None:
        if not self._is_damage_reported:
            self._is_damage_reported = True
            self._on_event(Message("event_history_spool_damaged"))


def _seconds(at: int) -> UnixTime:
    return UnixTime(at / SECOND)
