"""Suppression by design: what another alarm, or a line at rest, makes meaningless. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from app.conditions.condition import SuppressionGroup


@dataclass(frozen=True, slots=True)
class Suppressors:
    """What holds on one bus now."""

    groups: Collection[SuppressionGroup] = ()
    """The groups that conditions of the bus suppress."""
    at_rest: bool = False
    estops: Collection[int] = ()
    """The units whose emergency stop is active."""

    def suppress(self, group: SuppressionGroup | None, unit: int | None) -> bool:
        """Whether an alarm of this group and unit is suppressed."""
        return group in self.groups or (group == "speed" and (self.at_rest or unit in self.estops))


def is_at_rest(commanded: Iterable[int | None]) -> bool:
    """Whether zero is commanded to every unit; a unit that was never read is no proof of rest."""
    speeds = list(commanded)
    return bool(speeds) and all(speed == 0 for speed in speeds)
