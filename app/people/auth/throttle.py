"""How soon a sign-in may be tried again. Pure: ``now`` is a time in seconds.

A name and a place together back off: guessing waits, and no one is locked out elsewhere. A place is a browser
in which this name has signed in before (OWASP: device cookies), or else the network of the address. Such a
browser has its own count and waits for nothing else. Of the others a network that fails with many names
waits, and so does a name that many networks try, except at a network from which anyone has signed in before.

A network is judged alike for every name, whether a user has it or not: what it gets at a shared address does
not show which names exist.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from bus.instants import Monotonic
from bus.pacing import Bucket

K = TypeVar("K")
V = TypeVar("V")

FREE, FREE_OF_PANEL = 5, 3
"""Failures of a name at one place without any wait; a PIN has few digits."""
FIRST_WAIT_S, MAX_WAIT_S = 2.0, 300.0
FORGOTTEN_AFTER_S = 900.0
"""Failures no longer count after so long without one; the longest wait is over by then."""
OF_ADDRESS, OF_ADDRESS_WINDOW_S = 30, 300.0
"""Failures of one address, which several people may share behind a proxy; browsers with their own count do
not add to them."""
OF_NAME = 10
"""Tries of one name from networks where no one ever signed in, all together, before they are slowed down."""
OF_NAME_EVERY_S, OF_PANEL_EVERY_S = 10.0, 30.0
MAX_KEPT = 10_000
"""How many names, addresses and pairs each are remembered; what was used longest ago goes first."""


@dataclass(slots=True)
class _Failures:
    """The failures of one name at one place, and the time of the last."""

    count: int = 0
    at: Monotonic = Monotonic(0.0)

    def recent(self, now: Monotonic) -> int:
        """Return how many of them still count."""
        return self.count if now - self.at < FORGOTTEN_AFTER_S else 0


class Bounded(Generic[K, V]):
    """A store of at most ``most`` values by key; ``new`` makes the value of a new key."""

    def __init__(self, most: int, new: Callable[[], V]) -> None:
        self._most = most
        self._new = new
        self._values: OrderedDict[K, V] = OrderedDict()

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: K) -> V:
        """Return the value of a key, for reading; one that is changed must be `kept`."""
        found = self._values.get(key)
        return self._new() if found is None else found

    def kept(self, key: K) -> V:
        """Return the value of a key, to be changed; the key is the newest from now on."""
        found = self._values.setdefault(key, self._new())
        self._values.move_to_end(key)
        while len(self._values) > self._most:
            self._values.popitem(last=False)
        return found

    def drop(self, key: K) -> None:
        self._values.pop(key, None)


@dataclass(frozen=True, slots=True)
class Attempt:
    """A sign-in to be tried. ``own_browser``: ``place`` is a browser in which the name has signed in before;
    ``used_network``: it is a network from which someone has, under any name."""

    name: str
    place: str
    panel: bool = False
    own_browser: bool = False
    used_network: bool = False

    @property
    def known(self) -> bool:
        """Whether the place is known from an earlier sign-in."""
        return self.own_browser or self.used_network

    @property
    def pair(self) -> tuple[str, str]:
        """Return what backs off together."""
        return self.name, self.place


class Throttle:
    """The failures of the last quarter of an hour."""

    def __init__(self, most: int = MAX_KEPT) -> None:
        self._pairs: Bounded[tuple[str, str], _Failures] = Bounded(most, _Failures)
        self._places: Bounded[str, Bucket] = Bounded(
            most, lambda: Bucket(OF_ADDRESS / OF_ADDRESS_WINDOW_S, OF_ADDRESS)
        )
        self._names: Bounded[str, Bucket] = Bounded(most, lambda: Bucket(1 / OF_NAME_EVERY_S, OF_NAME))
        self._panels: Bounded[str, Bucket] = Bounded(most, lambda: Bucket(1 / OF_PANEL_EVERY_S, OF_NAME))

    def wait_s(self, attempt: Attempt, now: Monotonic) -> float:
        """Return the seconds that an attempt must wait; 0.0 for none."""
        waits = [self._wait_of_pair(attempt, now)]
        if not attempt.own_browser:
            waits.append(self._places.get(attempt.place).wait_s(now))
        if not attempt.known:
            waits.append(self._names_of(attempt).get(attempt.name).wait_s(now))
        return max(waits)

    def begin(self, attempt: Attempt, now: Monotonic) -> None:
        """Count an attempt before its result is known: otherwise each of many at once would be allowed."""
        if not attempt.known:
            self._names_of(attempt).kept(attempt.name).pour(1, now)

    def failed(self, attempt: Attempt, now: Monotonic) -> None:
        """Count a wrong secret."""
        failures = self._pairs.kept(attempt.pair)
        failures.count, failures.at = failures.recent(now) + 1, now
        if not attempt.own_browser:
            self._places.kept(attempt.place).pour(1, now)

    def succeeded(self, attempt: Attempt, now: Monotonic) -> None:
        """Count a right secret, which clears the failures of the name's own browser. Those of its network
        stay: others share it, and would learn that there is such a user."""
        if attempt.own_browser:
            self._pairs.drop(attempt.pair)
        if not attempt.known:
            self._names_of(attempt).kept(attempt.name).pour(-1, now)

    def _names_of(self, attempt: Attempt) -> Bounded[str, Bucket]:
        return self._panels if attempt.panel else self._names

    def _wait_of_pair(self, attempt: Attempt, now: Monotonic) -> float:
        failures = self._pairs.get(attempt.pair)
        over = failures.recent(now) - (FREE_OF_PANEL if attempt.panel else FREE)
        if over < 0:
            return 0.0
        wait: float = min(FIRST_WAIT_S * 2.0 ** min(over, 16), MAX_WAIT_S)
        return max(0.0, failures.at + wait - now)
