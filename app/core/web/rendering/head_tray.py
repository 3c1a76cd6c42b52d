"""The change trays of a person as every page shows them: how much is in each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from app.core.web.admission.access import Caller


@dataclass(frozen=True, slots=True)
class TrayCount:
    """What a person has gathered for one bus."""

    bus: str
    changes: int
    units: int


@dataclass(frozen=True, slots=True)
class HeadTray:
    """Gives the trays of a person that are not empty, of each bus."""

    of: Callable[[Caller], Sequence[TrayCount]]
