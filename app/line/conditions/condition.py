"""What one row states about an abnormal condition. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal
from typing import Generic, Literal, TypeVar, get_args

from app.line.conditions.evidence import ReadingPredicate, StatusPredicate
from app.line.conditions.priority import MATRIX, AlarmPriority, Consequence, TimeToRespond
from bus.messages import TEXTS, Message

Predicate = TypeVar("Predicate")
Rung = Literal["e-stop", "run", "mode", "link", "ramp"]
"""A rung of the ladder: what a unit needs to be at speed, each of which needs the one before."""
SuppressionGroup = Literal["bus", "cable", "unit", "speed"]
"""What the rows that ``suppress`` it hide; ``speed``: also an e-stop of the unit, and a line at rest."""

AlarmGroup = Literal["drive", "communication", "parameters", "system", "own"]
"""What an alarm is about. ``drive``: what the machine does; ``communication``: units, cable, port, worker;
``parameters``: what units are set to; ``system``: the server; ``own``: those of the site."""
GROUPS: tuple[AlarmGroup, ...] = get_args(AlarmGroup)


@dataclass(frozen=True, slots=True)
class Tuning:
    """The limits of an alarm, in percent, and its delays, in seconds. A site may set them."""

    above_percent: Decimal | None = None
    below_percent: Decimal | None = None
    deadband_percent: Decimal = Decimal(0)
    on_delay_s: float = 0.0
    off_delay_s: float = 0.0

    @property
    def fault(self) -> str:
        """The code of what is wrong with its limits; empty where nothing is."""
        above, below = self.above_percent, self.below_percent
        if above is None:
            return ""
        if below is not None and below >= above:
            return "setting_alarm_limits_reversed"
        room = above if below is None else (above - below) / 2
        return "setting_alarm_deadband_wide" if self.deadband_percent >= room else ""


@dataclass(frozen=True, slots=True)
class ConditionEvent:
    """The event of a change. ``began`` and ``ended``: codes of its text; ``off`` and ``on``: the words for
    not holding and holding."""

    kind: Literal["bus", "estop", "mode", "run", "unit"]
    began: str
    ended: str
    off: Message
    on: Message


@dataclass(frozen=True, slots=True)
class Condition(Generic[Predicate]):
    """One row. Its texts are messages named after its code. ``rated``: how severe it is, and how soon a
    person has to respond; ``means``: in the documentation, after *while*.

    On the ladder, ``broken`` is when its rung is, where that is more than ``holds``; ``names``: what its text
    names; ``status``: the bit whose changes are known, also from the history; ``since``: the bits that make
    it begin, its own by default. Raises ValueError for a row without a text."""

    code: str
    rated: tuple[Consequence, TimeToRespond]
    holds: Predicate
    means: str = ""
    tuning: Tuning = field(default_factory=Tuning)
    latching: bool = False
    group: SuppressionGroup | None = None
    about: AlarmGroup | None = None
    """Where that does not follow from its place."""
    suppresses: tuple[SuppressionGroup, ...] = ()
    """What follows from it, on all of its bus."""
    is_alarm: bool = True
    """False: a person caused it, it ends within seconds, or another condition has the alarm."""
    tiles: tuple[str, ...] = ()
    """The causes that tiles name where it holds, by their codes for programs. Named after them are two
    messages: what the tile names and, unless only time or a decision helps, what to check."""
    event: ConditionEvent | None = None
    rung: Rung | None = None
    broken: ReadingPredicate | None = None
    names: tuple[Literal["motion", "mode"], ...] = ()
    status: StatusPredicate | None = None
    since: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        missing = [text for text in self.texts if text not in TEXTS]
        if missing or not (self.means if self.is_alarm else self.tiles):
            raise ValueError(f"condition {self.code} has no text: {', '.join(missing) or 'what it means'}")

    @property
    def priority(self) -> AlarmPriority:
        """By the matrix; the same on every surface."""
        return MATRIX[self.rated]

    @property
    def texts(self) -> tuple[str, ...]:
        """The codes of its texts as an alarm: name, cause, consequence, response; none without an alarm."""
        parts = ("", "_cause", "_consequence", "_response") if self.is_alarm else ()
        return tuple(f"alarm_{self.code}{part}" for part in parts)
