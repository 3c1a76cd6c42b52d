"""What a simulation found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from app.alarms.rules.facts import Transition
from app.alarms.rules.performance import CHATTERS_S
from bus.instants import UnixTime

CHATTERING_TIMES = 3


@dataclass(slots=True)
class Annunciations:
    """When an alarm would have been annunciated, and how long it would have stood."""

    at: list[UnixTime] = field(default_factory=list)
    lengths: list[float] = field(default_factory=list)
    """Seconds for which it was active and not hidden, each time."""
    stands_since: UnixTime | None = None

    def see(self, transitions: Sequence[Transition]) -> None:
        """Take in what happened."""
        for each in transitions:
            stands = each.after == "unack_active"
            if stands and self.stands_since is None:
                self.at.append(each.at)
                self.stands_since = each.at
            elif not stands:
                self.end(each.at)

    def end(self, at: UnixTime) -> None:
        """End the present annunciation: the alarm cleared, was hidden, or the time is over."""
        if self.stands_since is not None:
            self.lengths.append(at - self.stands_since)
            self.stands_since = None

    @property
    def chattering(self) -> int:
        """How many are among three within a minute."""
        among: set[int] = set()
        last = CHATTERING_TIMES - 1
        for index in range(last, len(self.at)):
            if self.at[index] - self.at[index - last] <= CHATTERS_S:
                among.update(range(index - last, index + 1))
        return len(among)


@dataclass(frozen=True, slots=True)
class Simulated:
    """``start`` to ``end``: what was requested; ``covered_from`` to ``covered_to``: the readings of it.
    Durations in seconds."""

    start: UnixTime
    end: UnixTime
    covered_from: UnixTime | None = None
    covered_to: UnixTime | None = None
    annunciated: int = 0
    chattering: int = 0
    first: UnixTime | None = None
    last: UnixTime | None = None
    standing_s: float = 0.0
    longest_s: float | None = None
    stands_at_end: bool = False
    unknown_s: float = 0.0
    """How long, of the covered time, there was no reading or its condition was not known."""
    is_complete: bool = True
    """Whether all that is stored was judged within the bounds of a simulation."""
