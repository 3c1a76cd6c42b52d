"""The rules of the lease by which one server at a time is the home of a bus. Pure: times are arguments.

Two clocks count: that of the store, which writes ``until`` into the row, and the monotonic one of each
server. A holder counts from the moment at which it *began* a renewal that was confirmed, and gives up
`MARGIN_S` early. Another server takes a lease only once it has seen its row unchanged for `LEASE_S` by its
own monotonic clock; it began to look after the row was written, which is after the holder began. Neither
depends on a wall clock: a step of the store's clock and a row that is edited by hand give no bus two homes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from bus.contract import MAX_EPOCH
from bus.instants import Monotonic, UnixTime

SITE = ""
"""In the place of a bus: what one server does for the site."""
LEASE_S = 5.0
"""A home that is not renewed for so long is lost."""
RENEW_S = 1.0
MARGIN_S = 1.0
"""A holder gives up so much earlier: for the bytes on their way and for clocks that differ in rate."""
MAX_REQUEST_S = 30.0
"""For how long a bus is kept for the server that a person chose."""

Verdict = Literal["may_take", "not_permitted", "held", "held_by_namesake", "promised", "local", "unusable"]


class HomeRow(NamedTuple):
    """A row of the table ``home``. ``instance``: the process of the holder; ``released``: the same once the
    holder has given the bus up. The request is that of a person: which server is to take it, until
    ``request_ends`` on the store's clock."""

    bus: str
    holder: str
    instance: str
    epoch: int
    until: UnixTime
    renewals: int
    url: str
    taken_at: UnixTime
    reason: str
    released: str
    requested_by: str
    requested_for: str
    request_ends: UnixTime

    @property
    def is_released(self) -> bool:
        return bool(self.released) and self.released == self.instance

    def request(self, now: UnixTime) -> str:
        """The server that a person wants the bus at; empty: none."""
        return self.requested_for if now < self.request_ends <= now + MAX_REQUEST_S else ""


class Claimant(NamedTuple):
    """A server that may want a bus. ``permitted``: its setting ``home`` names it; ``automatic``: it takes the
    bus over from another server without a person."""

    server: str
    instance: str
    permitted: bool = True
    automatic: bool = True


@dataclass(frozen=True, slots=True)
class Sighting:
    """What a server has last seen of a row, and since when it has not changed."""

    row: HomeRow | None
    since: Monotonic
    changes: int = 0
    """How often it was seen to change, the first look among them."""
    highest: int = 0
    """The highest epoch that the bus ever had: a row that came and went between two looks shows there."""

    @property
    def is_first(self) -> bool:
        """No server has ever had the bus."""
        return self.changes > 0 and self.highest == 0 and self.row is None

    def again(self, row: HomeRow | None, now: Monotonic, highest: int = 0) -> Sighting:
        """The row was read; the read ended at ``now``."""
        if self.changes and (_mark(row), highest) == (_mark(self.row), self.highest):
            return Sighting(row, self.since, self.changes, highest)
        return Sighting(row, now, self.changes + 1, highest)


UNSEEN = Sighting(None, Monotonic(math.inf))


def _mark(row: HomeRow | None) -> tuple[object, ...] | None:
    """What a holder changes. A request or another text is no sign of life."""
    return (
        None if row is None else (row.holder, row.instance, row.epoch, row.until, row.renewals, row.released)
    )


def next_free(sightings: Iterable[Sighting], now: Monotonic) -> Monotonic:
    """When the first of these rows will have been unchanged for so long that it may be taken: who looks just
    before that waits for another look."""
    free = (seen.since + LEASE_S for seen in sightings)
    return min((at for at in free if at > now), default=Monotonic(math.inf))


def verdict(sighting: Sighting, claimant: Claimant, now: Monotonic, store_now: UnixTime) -> Verdict:
    """Whether a server may take the lease, or why not."""
    row = sighting.row
    if not claimant.permitted:
        return "not_permitted"
    if row is None:
        is_free = sighting.is_first or now - sighting.since >= LEASE_S
        return "may_take" if is_free else "held"
    if not 0 <= row.epoch < MAX_EPOCH:
        return "unusable"
    request = row.request(store_now)
    if request not in ("", claimant.server):
        return "promised"
    if not row.is_released and not _is_over(row, sighting, now, store_now):
        is_namesake = row.holder == claimant.server and row.instance != claimant.instance
        return "held_by_namesake" if is_namesake else "held"
    if request or claimant.automatic or row.holder == claimant.server:
        return "may_take"
    return "local"


def _is_over(row: HomeRow, sighting: Sighting, now: Monotonic, store_now: UnixTime) -> bool:
    """An ``until`` that lies further ahead than a lease was written by hand, or the store's clock stepped."""
    is_current = store_now < row.until <= store_now + LEASE_S
    return not is_current and now - sighting.since >= LEASE_S


@dataclass(frozen=True, slots=True)
class Lease:
    """A lease that this server holds. ``confirmed``: when it began the last renewal that was confirmed."""

    epoch: int
    confirmed: Monotonic

    def renewed(self, began: Monotonic) -> Lease:
        """A renewal that was begun at ``began`` was confirmed, however long it took."""
        return Lease(self.epoch, max(self.confirmed, began))

    def left_s(self, now: Monotonic) -> float:
        """For how many seconds it is still held; negative: it is lost."""
        return self.confirmed + (LEASE_S - MARGIN_S) - now
