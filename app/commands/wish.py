"""One command as somebody asked for it."""

from __future__ import annotations

from dataclasses import dataclass

from app.feed.channel import ProgressListener
from app.web.access import Person
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Action, WriteParameter


@dataclass(frozen=True, slots=True)
class Wish:
    """``deadline``: the last moment at which a frame that writes may leave, seconds since the epoch."""

    id: str
    person: Person
    bus: str
    action: Action
    deadline: float
    origin: str
    listener: ProgressListener | None = None

    @property
    def unit(self) -> int | None:
        """The one unit it is about, if it is about one."""
        unit = getattr(self.action, "unit", None)
        return unit if isinstance(unit, int) else None


def writes_secret(action: Action) -> bool:
    """Whether the frames of this action carry what is not to be shown (#21)."""
    return isinstance(action, WriteParameter) and PARAMETERS[action.number].secret
