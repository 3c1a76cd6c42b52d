"""Since when a condition holds. Pure: the times of readings in, Unix time in seconds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from bus.instants import UnixTime

UNSEEN_S = 60.0
"""A condition before and after a gap of at most this, such as a restart, counts as uninterrupted."""
_NOTHING: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Onset:
    """When something began. Not ``exact``: it was first seen then and may have begun earlier."""

    at: UnixTime
    exact: bool = True


WordSpan = tuple[UnixTime, UnixTime, int]
"""From when until when the status bits of a unit were the same, and those: ST2 * 256 + ST1."""


@dataclass(slots=True)
class Onsets:
    """The conditions of one unit that hold now, each with its onset."""

    of: dict[str, Onset] = field(default_factory=dict)
    _held: frozenset[str] = _NOTHING
    _seen_at: UnixTime = UnixTime(-math.inf)

    def see(self, at: UnixTime, holding: frozenset[str], change_seen_s: float) -> None:
        """Take in a reading. ``change_seen_s``: a change between two readings that are at most so far apart,
        the time after which a unit counts as offline, has its time from the later one; else it has none."""
        gap, self._seen_at = at - self._seen_at, at
        if holding == self._held and gap <= UNSEEN_S:
            return
        held = self._held if gap <= UNSEEN_S else _NOTHING
        begun = dict.fromkeys(holding - held, Onset(at, exact=gap <= change_seen_s))
        self.of = {name: onset for name, onset in self.of.items() if name in holding & held} | begun
        self._held = holding

    def correct(self, name: str, seen: Onset, found: Onset) -> bool:
        """Replace the onset ``seen`` by what was ``found`` elsewhere; gives whether that is news."""
        if self.of.get(name) != seen or seen == found:
            return False
        self.of[name] = found
        return True


def later(*onsets: Onset | None) -> Onset | None:
    """When all of several conditions held first; None when one of them does not hold."""
    known = [onset for onset in onsets if onset is not None]
    return max(known, key=lambda onset: onset.at) if len(known) == len(onsets) else None


def onset_in(
    spans: Sequence[WordSpan], holds: Callable[[int], bool], seen: Onset, change_seen_s: float
) -> tuple[Onset, bool]:
    """The onset of a condition that was first ``seen`` then, by the status bits before, in order of time.
    Second: whether the spans reach back to where it began."""
    began = seen.at
    for at, until, word in reversed([span for span in spans if span[0] < seen.at]):
        gap = began - until
        if not holds(word):
            return Onset(began, exact=gap <= change_seen_s), True
        if gap > UNSEEN_S:
            return Onset(began, exact=False), True
        began = at
    return Onset(began, exact=False), False
