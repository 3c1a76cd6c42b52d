"""How soon a sign-in may be tried again. Pure: ``now`` is a time in seconds.

A name and a place together back off, so whoever guesses waits, and nobody is locked out elsewhere. A place is
a browser that has signed in with this name before, or else the network of the address. A name is slowed down
as a whole only for places from which it never signed in: many addresses that guess one name together get one
try in a while, and its owner is not among them. A network that fails with many names waits, except for names
that have signed in from it.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from ipaddress import IPv4Address, ip_address, ip_network
from typing import Generic, TypeVar

K = TypeVar("K")

FREE, FREE_OF_PANEL = 5, 3
"""Failures of a name at one place without any wait; a PIN has few digits."""
FIRST_WAIT_S, LONGEST_WAIT_S = 2.0, 300.0
FORGOTTEN_AFTER_S = 900.0
"""Without a failure; the longest wait is over by then."""
OF_ADDRESS, OF_ADDRESS_WINDOW_S = 30, 300.0
"""Failures of one address: more people than one sit behind a proxy."""
OF_NAME = 10
"""Tries of one name from places where it never signed in, all together, before they are slowed down."""
OF_NAME_EVERY_S, OF_PANEL_EVERY_S = 10.0, 30.0
MOST_KEPT = 10_000
"""Of names, addresses and pairs each; what was used longest ago goes first."""


def network_of(address: str) -> str:
    """What counts as one address: an IPv4 address, or the /64 of an IPv6 one, which is one customer's."""
    try:
        parsed = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if not isinstance(parsed, IPv4Address):
        if parsed.ipv4_mapped is None:
            return str(ip_network((parsed, 64), strict=False))
        parsed = parsed.ipv4_mapped
    return str(parsed)


@dataclass(slots=True)
class _Count:
    """A count that leaks one in ``every_s`` (0: it does not leak), and when it was last added to."""

    level: float = 0.0
    at: float = 0.0

    def leaked(self, now: float, every_s: float) -> float:
        return max(0.0, self.level - (now - self.at) / every_s)


class _Kept(Generic[K]):
    """Counts by key, no more than ``most``."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._counts: OrderedDict[K, _Count] = OrderedDict()

    def __len__(self) -> int:
        return len(self._counts)

    def get(self, key: K) -> _Count:
        return self._counts.get(key) or _Count()

    def put(self, key: K, level: float, now: float) -> None:
        self._counts[key] = _Count(level, now)
        self._counts.move_to_end(key)
        while len(self._counts) > self._most:
            self._counts.popitem(last=False)

    def drop(self, key: K) -> None:
        self._counts.pop(key, None)


@dataclass(frozen=True, slots=True)
class Attempt:
    """A sign-in to be tried. ``known``: the name has signed in from this ``place`` before."""

    name: str
    place: str
    panel: bool = False
    known: bool = False

    @property
    def pair(self) -> tuple[str, str]:
        """What backs off together."""
        return self.name, self.place

    @property
    def of_name_every_s(self) -> float:
        """How often strangers together may try this name in the long run."""
        return OF_PANEL_EVERY_S if self.panel else OF_NAME_EVERY_S


class Throttle:
    """What failed in the last quarter of an hour."""

    def __init__(self, most: int = MOST_KEPT) -> None:
        self._pairs: _Kept[tuple[str, str]] = _Kept(most)
        self._places: _Kept[str] = _Kept(most)
        self._names: _Kept[str] = _Kept(most)

    def wait_s(self, attempt: Attempt, now: float) -> float:
        """For how many seconds this is not to be tried; 0.0: now."""
        waits = [self._wait_of_pair(attempt, now)]
        if not attempt.known:
            waits += [self._wait_of_place(attempt, now), self._wait_of_name(attempt, now)]
        return max(waits)

    def begin(self, attempt: Attempt, now: float) -> None:
        """It is tried. Noted before its end, lest many at once each be the last that is allowed."""
        if not attempt.known:
            level = self._names.get(attempt.name).leaked(now, attempt.of_name_every_s)
            self._names.put(attempt.name, level + 1, now)

    def failed(self, attempt: Attempt, now: float) -> None:
        """It was wrong."""
        self._pairs.put(attempt.pair, self._failures(attempt, now) + 1, now)
        level = self._places.get(attempt.place).leaked(now, OF_ADDRESS_WINDOW_S / OF_ADDRESS)
        self._places.put(attempt.place, level + 1, now)

    def succeeded(self, attempt: Attempt, now: float) -> None:
        """It was right: nothing of this name counts against this place; what others tried still does."""
        self._pairs.drop(attempt.pair)
        if not attempt.known:
            level = self._names.get(attempt.name).leaked(now, attempt.of_name_every_s)
            self._names.put(attempt.name, max(0.0, level - 1), now)

    def _failures(self, attempt: Attempt, now: float) -> float:
        count = self._pairs.get(attempt.pair)
        return count.level if now - count.at < FORGOTTEN_AFTER_S else 0.0

    def _wait_of_pair(self, attempt: Attempt, now: float) -> float:
        over = self._failures(attempt, now) - (FREE_OF_PANEL if attempt.panel else FREE)
        if over < 0:
            return 0.0
        wait: float = min(FIRST_WAIT_S * 2.0 ** min(over, 16.0), LONGEST_WAIT_S)
        return max(0.0, self._pairs.get(attempt.pair).at + wait - now)

    def _wait_of_place(self, attempt: Attempt, now: float) -> float:
        every_s = OF_ADDRESS_WINDOW_S / OF_ADDRESS
        over = self._places.get(attempt.place).leaked(now, every_s) - (OF_ADDRESS - 1)
        return max(0.0, over * every_s)

    def _wait_of_name(self, attempt: Attempt, now: float) -> float:
        every_s = attempt.of_name_every_s
        over = self._names.get(attempt.name).leaked(now, every_s) - (OF_NAME - 1)
        return max(0.0, over * every_s)
