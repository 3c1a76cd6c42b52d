"""Stores the leases of homes, on the clock of the store.

Each change is a statement that names whose row it changes, so nothing waits for other buses. Taking alone has
more than one, and is under a lock.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from itertools import chain
from typing import NamedTuple

from app.database import Database, StoreConnection
from app.database.connection import notify, upsert
from app.errors import StoreError
from app.home.lease import LEASE_S, MAX_REQUEST_S, Claimant, HomeRow, Sighting, Verdict, verdict
from bus.contract import MAX_EPOCH
from bus.instants import MonotonicClock, UnixTime, unix_now

LOCK = "home"
CHANNEL = "home"
"""Notified of a bus that was released or requested, and is to be looked at at once."""
NO_TIME = UnixTime(0.0)
_COLUMNS = ", ".join(HomeRow._fields)
_UPSERT_EPOCH = upsert("home_epoch", ("bus",), ("epoch",))
_UPSERT = upsert("home", HomeRow._fields[:1], HomeRow._fields[1:])


class Beat(NamedTuple):
    """One look at all rows, with the own ones renewed before. ``now``: of the store's clock."""

    now: UnixTime
    rows: Mapping[str, HomeRow]
    highest: Mapping[str, int]
    """The highest epoch that each bus ever had."""


class HomeStore:
    """All access to the table ``home``."""

    def __init__(self, database: Database, monotonic: MonotonicClock) -> None:
        self._database = database
        self._monotonic = monotonic
        self._late: set[asyncio.Task[None]] = set()

    def listen(self, callback: Callable[[], None]) -> None:
        """Call ``callback`` on this event loop where a bus was released or requested by any server."""
        self._database.listen(CHANNEL, lambda _: callback())

    @property
    def is_away(self) -> bool:
        """Whether nothing but leases can be read and written now."""
        return False

    async def beat(self, server: str, instance: str, url: str, epochs: Mapping[str, int]) -> Beat:
        """Renew what this process holds, by bus and epoch, where the row agrees; then read all rows."""

        def renew(connection: StoreConnection) -> Beat:
            now = unix_now()
            if epochs:
                held = ", ".join(["(?, ?)"] * len(epochs))
                connection.execute(
                    "UPDATE home SET until = ?, url = ?, renewals = renewals + 1"
                    " WHERE holder = ? AND instance = ? AND released = ''"
                    f" AND (bus, epoch) IN (VALUES {held})",
                    (now + LEASE_S, url, server, instance, *chain.from_iterable(epochs.items())),
                )
            return Beat(now, _rows(connection), _highest(connection))

        return await self._database.write(renew)

    async def take_all(self, server: str, instance: str, url: str, buses: Iterable[str]) -> Beat:
        """Make the only server of this store the home of each bus, with the next epoch."""

        def take(connection: StoreConnection) -> Beat:
            now, rows, highest = unix_now(), _rows(connection), _highest(connection)
            taken = {
                bus: HomeRow(
                    bus,
                    server,
                    instance,
                    max(_epoch_of(rows.get(bus)), highest.get(bus, 0)) + 1,
                    NO_TIME,
                    0,
                    url,
                    now,
                    reason="",
                    released="",
                    requested_by="",
                    requested_for="",
                    request_ends=NO_TIME,
                )
                for bus in buses
            }
            connection.executemany(_UPSERT, list(taken.values()))
            connection.executemany(_UPSERT_EPOCH, [(row.bus, row.epoch) for row in taken.values()])
            return Beat(now, taken, {row.bus: row.epoch for row in taken.values()})

        return await self._database.write(take)

    async def take(
        self,
        sighting: Sighting,
        claimant: Claimant,
        bus: str,
        *,
        url: str,
        epoch_above: int,
        reason: str,
        within_s: float,
    ) -> HomeRow | Verdict:
        """Take the lease of ``bus``, with an epoch above the row's and ``epoch_above``; or why not. It must
        be as it was seen last. Raises TimeoutError after ``within_s``; what is taken later is released."""

        def take(connection: StoreConnection) -> HomeRow | Verdict:
            # From here on its holder renews it only if this ends without a change.
            connection.execute("UPDATE home SET bus = bus WHERE bus = ?", (bus,))
            now, row = unix_now(), _rows(connection).get(bus)
            highest = _highest(connection).get(bus, 0)
            # A row that was changed since the last look is of this moment.
            seen = sighting.again(row, self._monotonic(), highest)
            found = verdict(seen, claimant, self._monotonic(), now)
            if found != "may_take":
                return found
            taken = HomeRow(
                bus=bus,
                holder=claimant.server,
                instance=claimant.instance,
                epoch=max(epoch_above, highest, _epoch_of(row)) + 1,
                until=now + LEASE_S,
                renewals=0 if row is None else row.renewals + 1,
                url=url,
                taken_at=now,
                reason=row.reason if row is not None and row.request(now) else reason,
                released="",
                requested_by=row.requested_by if row is not None and row.request(now) else "",
                requested_for="",
                request_ends=NO_TIME,
            )
            connection.execute(_UPSERT, taken)
            connection.execute(_UPSERT_EPOCH, (bus, taken.epoch))
            return taken

        taking = asyncio.create_task(self._database.write(take))
        await asyncio.wait({taking}, timeout=within_s)
        if not taking.done():
            # Else no server would have the bus until this lease has run out.
            late = asyncio.create_task(self._release_late(bus, claimant.instance, taking))
            self._late.add(late)
            late.add_done_callback(self._late.discard)
            raise TimeoutError
        return taking.result()

    async def _release_late(self, bus: str, instance: str, taking: asyncio.Task[HomeRow | Verdict]) -> None:
        with suppress(StoreError):
            if isinstance(taken := await taking, HomeRow):
                await self.release(bus, instance, taken.epoch)

    async def renumber(self, bus: str, instance: str, epoch: int, above: int) -> int:
        """Raise the epoch of a lease that this process holds to one above ``above``, which a worker has seen.
        Returns it, or 0 where it is not held."""

        def renumber(connection: StoreConnection) -> int:
            changed = connection.execute(
                "UPDATE home SET epoch = ? WHERE bus = ? AND instance = ? AND epoch = ? AND released = ''",
                (above + 1, bus, instance, epoch),
            )
            if not changed.rowcount:
                return 0
            connection.execute(_UPSERT_EPOCH, (bus, above + 1))
            return above + 1

        return await self._database.write(renumber)

    async def release(self, bus: str, instance: str, epoch: int) -> None:
        """Give a lease up: its port is closed, and another server may take it at once."""

        def release(connection: StoreConnection) -> None:
            connection.execute(
                "UPDATE home SET released = instance WHERE bus = ? AND instance = ? AND epoch = ?",
                (bus, instance, epoch),
            )
            notify(connection, CHANNEL, bus or "site")

        await self._database.write(release)


def request_home(database: Database, bus: str, server: str, *, who: str, reason: str) -> bool:
    """Note on this thread that a person wants ``bus`` at ``server``; False where no server has had it."""

    def request(connection: StoreConnection) -> bool:
        ends = unix_now() + MAX_REQUEST_S
        changed = connection.execute(
            "UPDATE home SET requested_by = ?, requested_for = ?, request_ends = ?, reason = ? WHERE bus = ?",
            (who, server, ends, reason, bus),
        )
        if changed.rowcount:
            notify(connection, CHANNEL, bus)
        return changed.rowcount > 0

    return database.write_now(request)


def read_homes(connection: StoreConnection) -> Beat:
    """All rows, and the time of the store."""
    return Beat(unix_now(), _rows(connection), _highest(connection))


def holders_now(connection: StoreConnection) -> list[str]:
    """The servers that are the home of a bus at this moment, or of the site, by name. With SQLite none is
    renewed."""
    beat = read_homes(connection)
    return sorted({row.holder for row in beat.rows.values() if beat.now < row.until and not row.is_released})


def _rows(connection: StoreConnection) -> dict[str, HomeRow]:
    found = connection.execute(f"SELECT {_COLUMNS} FROM home")
    rows = (HomeRow(*row) for row in found)
    return {row.bus: row for row in rows}


def _highest(connection: StoreConnection) -> dict[str, int]:
    return {row[0]: row[1] for row in connection.execute("SELECT bus, epoch FROM home_epoch")}


def _epoch_of(row: HomeRow | None) -> int:
    """The epoch of a row; one that was edited to none counts as the lowest."""
    return row.epoch if row is not None and 0 <= row.epoch < MAX_EPOCH - 1 else 0
