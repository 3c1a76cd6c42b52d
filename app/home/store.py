"""Stores the leases of homes. Every change is made under one lock, on the clock of the store."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from app.database import Database, StoreConnection, engine
from app.home.lease import LEASE_S, MAX_WISH_S, Claimant, HomeRow, Sighting, Verdict, verdict
from bus.contract import MAX_EPOCH
from bus.instants import MonotonicClock, UnixTime

LOCK = "home"
NO_TIME = UnixTime(0.0)
_COLUMNS = ", ".join(HomeRow._fields)
_UPSERT = engine.upsert("home", HomeRow._fields[:1], HomeRow._fields[1:])


class Beat(NamedTuple):
    """One look at all rows, with the own ones renewed before. ``now``: of the store's clock."""

    now: UnixTime
    rows: Mapping[str, HomeRow]


class HomeStore:
    """All access to the table ``home``."""

    def __init__(self, database: Database, monotonic: MonotonicClock) -> None:
        self._database = database
        self._monotonic = monotonic

    async def beat(self, server: str, instance: str, url: str, epochs: Mapping[str, int]) -> Beat:
        """Renew what this process holds, by bus and epoch, where the row says so too; then read all rows."""

        def renew(connection: StoreConnection) -> Beat:
            engine.lock(connection, LOCK)
            now = engine.clock(connection)
            connection.executemany(
                "UPDATE home SET until = ?, url = ? WHERE bus = ? AND epoch = ? AND holder = ?"
                " AND instance = ? AND released = ''",
                [(now + LEASE_S, url, bus, epoch, server, instance) for bus, epoch in epochs.items()],
            )
            return Beat(now, _rows(connection))

        return await self._database.write(renew)

    async def rows(self) -> Beat:
        """All rows, and the time of the store."""
        return await self._database.read(_beat)

    def rows_now(self) -> Beat:
        """The same on this thread, for the command line."""
        return self._database.read_now(_beat)

    async def take_all(self, server: str, instance: str, url: str, buses: Iterable[str]) -> Beat:
        """Make the only server of this store the home of each bus, with the next epoch."""

        def take(connection: StoreConnection) -> Beat:
            now, rows = engine.clock(connection), _rows(connection)
            taken = {
                bus: HomeRow(
                    bus,
                    server,
                    instance,
                    _epoch_of(rows.get(bus)) + 1,
                    NO_TIME,
                    url,
                    now,
                    reason="",
                    released="",
                    wished_by="",
                    wished_for="",
                    wish_ends=NO_TIME,
                )
                for bus in buses
            }
            connection.executemany(_UPSERT, list(taken.values()))
            return Beat(now, taken)

        return await self._database.write(take)

    async def take(
        self, sighting: Sighting, claimant: Claimant, bus: str, *, url: str, epoch_above: int, reason: str
    ) -> HomeRow | Verdict:
        """Take the lease of ``bus``, with an epoch above the row's and ``epoch_above``; or why not. It must
        be as it was seen last."""

        def take(connection: StoreConnection) -> HomeRow | Verdict:
            engine.lock(connection, LOCK)
            now, row = engine.clock(connection), _rows(connection).get(bus)
            # A row that was changed since the last look is of this moment.
            found = verdict(sighting.again(row, self._monotonic()), claimant, self._monotonic(), now)
            if found != "may_take":
                return found
            taken = HomeRow(
                bus=bus,
                holder=claimant.server,
                instance=claimant.instance,
                epoch=max(epoch_above, _epoch_of(row)) + 1,
                until=now + LEASE_S,
                url=url,
                taken_at=now,
                reason=row.reason if row is not None and row.wish(now) else reason,
                released="",
                wished_by=row.wished_by if row is not None and row.wish(now) else "",
                wished_for="",
                wish_ends=NO_TIME,
            )
            connection.execute(_UPSERT, taken)
            return taken

        return await self._database.write(take)

    async def release(self, bus: str, instance: str, epoch: int) -> None:
        """Give a lease up: its port is closed, and another server may take it at once."""

        def release(connection: StoreConnection) -> None:
            engine.lock(connection, LOCK)
            connection.execute(
                "UPDATE home SET released = instance WHERE bus = ? AND instance = ? AND epoch = ?",
                (bus, instance, epoch),
            )

        await self._database.write(release)

    def wish_now(self, bus: str, server: str, *, who: str, reason: str) -> bool:
        """Note on this thread that a person wants ``bus`` at ``server``; False where no server has had it."""

        def wish(connection: StoreConnection) -> bool:
            engine.lock(connection, LOCK)
            ends = engine.clock(connection) + MAX_WISH_S
            changed = connection.execute(
                "UPDATE home SET wished_by = ?, wished_for = ?, wish_ends = ?, reason = ? WHERE bus = ?",
                (who, server, ends, reason, bus),
            )
            return changed.rowcount > 0

        return self._database.write_now(wish)


def holders_now(connection: StoreConnection) -> list[str]:
    """The servers that are the home of a bus at this moment, or of the site, by name. With SQLite none is
    renewed."""
    now, rows = _beat(connection)
    return sorted({row.holder for row in rows.values() if now < row.until and not row.is_released})


def _beat(connection: StoreConnection) -> Beat:
    return Beat(engine.clock(connection), _rows(connection))


def _rows(connection: StoreConnection) -> dict[str, HomeRow]:
    found = connection.execute(f"SELECT {_COLUMNS} FROM home")
    rows = (HomeRow(*row) for row in found)
    return {row.bus: row for row in rows}


def _epoch_of(row: HomeRow | None) -> int:
    """The epoch of a row; one that was edited to none counts as the lowest."""
    return row.epoch if row is not None and 0 <= row.epoch < MAX_EPOCH - 1 else 0
