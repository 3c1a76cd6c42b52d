"""What a simulation found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from app.alarms.rules.facts import Transition
from app.alarms.rules.performance import CHATTERS_S
from app.web.api.shape import InstantObject
from bus.instants import UnixTime

CHATTERING_TIMES = 3
SimulatedTime = Annotated[InstantObject | None, Field(description="ISO 8601 in UTC; null: there is none.")]


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
class AlarmSimulation:
    """What the alarm would have done. Durations in seconds."""

    start: Annotated[InstantObject, Field(serialization_alias="from")]
    end: Annotated[InstantObject, Field(serialization_alias="to")]
    covered_from: Annotated[
        InstantObject | None,
        Field(description="From when on readings are stored; null: none of this time are."),
    ]
    covered_to: SimulatedTime
    annunciated: Annotated[int, Field(description="How often it would have come.")]
    chattering: Annotated[int, Field(description="How many of them were among three within a minute.")]
    first: SimulatedTime
    last: SimulatedTime
    standing_s: Annotated[float, Field(description="Active and not suppressed, in total.")]
    longest_s: Annotated[float | None, Field(description="The longest time; null: it did not come.")]
    stands_at_end: bool
    unknown_s: Annotated[float, Field(description="About; of the covered time: no readings, or no scale.")]
    complete: Annotated[bool, Field(description="false: the work was ended at covered_to.")]
    toml: Annotated[str, Field(description="The entry for lineside.toml.")]
