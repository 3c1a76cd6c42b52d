"""One command as somebody asked for it."""

from __future__ import annotations

from dataclasses import dataclass

from app.feed.channel import ProgressListener
from app.live.state import BusLive
from app.web.access import Person
from app.web.deadline import DEFAULT_TIMEOUT_S, Deadline
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Action, WriteParameter
from bus.contract.durations import longest_stage_s


@dataclass(frozen=True, slots=True)
class Wish:
    """``deadline``: the last moment at which a frame that writes may leave."""

    id: str
    person: Person
    bus: str
    action: Action
    deadline: Deadline
    origin: str
    listener: ProgressListener | None = None

    @property
    def unit(self) -> int | None:
        """The one unit it is about, if it is about one."""
        unit = getattr(self.action, "unit", None)
        return unit if isinstance(unit, int) else None


def timeout_s_for(bus: BusLive, staged_units: int = 0) -> float:
    """How long a command may wait where its sender does not say: a change of several units needs the time of
    its staging too. ``staged_units``: how many, 0 for a command to one."""
    return DEFAULT_TIMEOUT_S + staged_units * longest_stage_s(bus.baud, bus.settings.turnaround_s)


def writes_secret(action: Action) -> bool:
    """Whether the frames of this action carry what is not to be shown (#21)."""
    return isinstance(action, WriteParameter) and PARAMETERS[action.number].secret
