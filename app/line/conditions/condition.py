"""The row of an abnormal condition, its priority, and the facts that predicates judge, such as the draw: by
how many percent a section of a line is faster than the section before it. Pure.

A priority follows from the consequence and the time to respond (EEMUA 191, 4.4; ISA-18.2-2016, clause 9).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Generic, Literal, NamedTuple, Protocol, TypeVar, get_args

from bus.catalogue.parameters import FOLLOWER_MODE
from bus.catalogue.values import StatusBits, is_follower
from bus.contract import BusFigures, ParameterValue, Reading
from bus.messages import TEXTS, Message, number
from bus.settings import BusSettings, DrawBand, UnitSettings

DrawState = Literal["in_band", "out_of_band", "ramping", "unknown", "none"]
"""``ramping``: it has a band, but a section ramps; ``unknown``: a speed is not of the present; ``none``:
there is no draw, or no band to judge it by."""
DRAW_DECIMALS = 1
MAX_TENTHS = 99_999
"""The largest draw in tenths of a percent: a section beside one that crawls would have millions."""
_TENTHS = 1000
"""The tenths of a percent in the whole."""


class SectionSpeed(NamedTuple):
    """A speed as a unit reports it. ``raw`` None: it is out of date; ``decimals``: those of its display (#3),
    None while not known; ``quantity``: the measure of its display, such as m/min; None for a ratio to a
    master, which is no speed."""

    raw: int | None
    decimals: int | None
    quantity: str | None


class Draw(NamedTuple):
    """The draw of a section. ``tenths``: the tenths of a percent, at most `MAX_TENTHS`; None without a known
    draw."""

    state: DrawState
    tenths: int | None = None


NO_DRAW, UNKNOWN_DRAW = Draw("none"), Draw("unknown")


def draw_between(before: SectionSpeed, section: SectionSpeed, band: DrawBand, *, judged: bool = True) -> Draw:
    """Return the draw of a section to the one before: none while either stands or their displays have
    different quantities. ``judged`` False: a draw out of its band means nothing yet, because a section
    ramps."""
    if before.quantity is None or before.quantity != section.quantity or 0 in (before.raw, section.raw):
        return NO_DRAW
    if before.raw is None or section.raw is None or before.decimals is None or section.decimals is None:
        return UNKNOWN_DRAW
    tenths = _tenths(before.raw * 10**section.decimals, section.raw * 10**before.decimals)
    if not (band and judged):
        return Draw("ramping" if band else "none", tenths)
    low, high = band
    return Draw("in_band" if low <= percent_of(tenths) <= high else "out_of_band", tenths)


def percent_of(tenths: int) -> Decimal:
    """Return a draw as a number of percent."""
    return Decimal(tenths).scaleb(-DRAW_DECIMALS)


def percent_message(percent: Decimal, sign: str = "") -> Message:
    """Return a number of percent as the reader's language writes it; ``sign`` "+": always with its sign."""
    text = f"{percent:{sign}}".replace("-", "\N{MINUS SIGN}")
    return number(text if percent else text.replace("+", "±"))


def _tenths(before: int, section: int) -> int:
    """Return tenths of a percent, rounded once, half away from zero, so that the judged draw is the shown
    one."""
    size = (2 * _TENTHS * abs(section - before) + before) // (2 * before)
    return min(size, MAX_TENTHS) if section >= before else -size


AlarmPriority = Literal["urgent", "high", "medium", "low"]
PRIORITIES: tuple[AlarmPriority, ...] = ("urgent", "high", "medium", "low")
Consequence = Literal["minor", "major", "severe"]
TimeToRespond = Literal["minutes", "half_hour", "shift"]
"""The time until the consequence can no longer be averted: ten minutes, thirty, or the rest of the shift."""

MATRIX: dict[tuple[Consequence, TimeToRespond], AlarmPriority] = {
    ("severe", "minutes"): "urgent",
    ("severe", "half_hour"): "high",
    ("severe", "shift"): "medium",
    ("major", "minutes"): "high",
    ("major", "half_hour"): "medium",
    ("major", "shift"): "low",
    ("minor", "minutes"): "medium",
    ("minor", "half_hour"): "low",
    ("minor", "shift"): "low",
}


class UnitFacts(NamedTuple):
    """The facts about a unit by a reading. ``motion``: a MotionState; ``is_late``: whether a response is
    overdue."""

    bits: StatusBits
    motion: str
    commanded: int | None
    actual: int | None
    is_late: bool = False


class LinkFacts(NamedTuple):
    """The facts about the link of a unit. ``is_alone``: of several units, no other has responded since it was
    lost."""

    bus_is_readable: bool
    is_lost: bool
    is_online: bool
    is_alone: bool


class BusFacts(NamedTuple):
    """The facts about a bus. ``units``: their number; ``lost``: those that do not respond; ``unread``: those
    that have not responded yet and still have time; ``scan_s``: seconds of a scan, None while not measured;
    ``longest_scan_s``: of one in which each unit takes its full turnaround."""

    worker_is_lost: bool
    port_is_closed: bool
    units: int
    lost: int
    unread: int
    scan_s: float | None
    longest_scan_s: float

    @property
    def is_readable(self) -> bool:
        return not (self.worker_is_lost or self.port_is_closed)

    @property
    def has_no_response(self) -> bool:
        """Whether none of several units responds; the only unit of a bus is named itself."""
        return self.units > 1 and self.lost + self.unread == self.units


class MotionValue(Protocol):
    """The motion of a unit."""

    @property
    def state(self) -> str: ...


class UnitValues(Protocol):
    """The part of a unit's live state that predicates read; the live state itself is in a higher layer."""

    @property
    def settings(self) -> UnitSettings: ...
    @property
    def motion(self) -> MotionValue: ...
    @property
    def staged(self) -> int | None: ...
    @property
    def reading(self) -> Reading | None: ...
    @property
    def parameters(self) -> Mapping[int, ParameterValue]: ...
    def parameter_raw(self, number: int, /) -> int | None: ...


class BusValues(Protocol):
    """The part of a bus's live state that predicates read; the live state itself is in a higher layer."""

    @property
    def settings(self) -> BusSettings: ...
    @property
    def figures(self) -> BusFigures | None: ...
    @property
    def units(self) -> Mapping[int, UnitValues]: ...


LimitCheck = Callable[[int, int], bool]
"""A function of a value and its full scale that returns whether the value passes the alarm's limits."""
StatusPredicate = Callable[[StatusBits], bool]
ReadingPredicate = Callable[[UnitFacts], bool]
ValuePredicate = Callable[[BusValues, UnitValues, Reading, LimitCheck], bool | None]
ParameterPredicate = Callable[[BusValues, UnitValues], bool | None]
DrawPredicate = Callable[[Draw], bool | None]
LinkPredicate = Callable[[LinkFacts], bool | None]
BusPredicate = Callable[[BusFacts], bool | None]
CountPredicate = Callable[[int, int], bool]
"""A function of the number of polls in a minute and the number of those with a fault."""
StatePredicate = Callable[[str], bool]


def follower(unit: UnitValues) -> bool | None:
    """Return whether #8 makes the unit follow a master by a ratio; None while it was not read."""
    mode = unit.parameter_raw(FOLLOWER_MODE)
    return None if mode is None else is_follower(mode)


def reads_ratio(bus: BusValues, unit: UnitValues) -> bool:
    """Return whether commanded and actual speed of a unit are ratios to its master, in the dialect of its
    bus."""
    return bus.settings.follower_speed == "ratio" and bool(follower(unit))


Predicate = TypeVar("Predicate")
Rung = Literal["e-stop", "run", "mode", "link", "ramp"]
"""A rung of the ladder: what a unit needs to be at speed, each of which needs the one before."""
SuppressionGroup = Literal["bus", "cable", "unit", "speed"]
"""The rows that are hidden while a row that ``suppresses`` their group holds; ``speed`` also by an e-stop of
the unit and a line at rest."""

AlarmGroup = Literal["drive", "communication", "parameters", "system", "own"]
"""The subject of an alarm. ``drive``: what the machine does; ``communication``: units, cable, port, worker;
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
        """The code of a fault of the limits; empty if there is none."""
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
    """The row of one condition. Its texts are messages named after its code. ``rated``: how severe it is, and
    how soon a person has to respond; ``means``: its meaning in the documentation, after *while*.

    On the ladder, ``broken`` states when its rung is broken, if that is more than ``holds``; ``names``: what
    its text names; ``status``: the bit whose changes are known, also from the history; ``since``: the bits
    that make it begin, its own by default. Raises ValueError for a row without a text.
    """

    code: str
    rated: tuple[Consequence, TimeToRespond]
    holds: Predicate
    means: str = ""
    tuning: Tuning = field(default_factory=Tuning)
    latching: bool = False
    group: SuppressionGroup | None = None
    about: AlarmGroup | None = None
    """Set if the group does not follow from the place of the condition."""
    suppresses: tuple[SuppressionGroup, ...] = ()
    """The groups that follow from the condition, on the complete bus."""
    is_alarm: bool = True
    """False if a person caused it, it ends within seconds, or another condition has the alarm."""
    tiles: tuple[str, ...] = ()
    """The causes that tiles name while it holds, by their codes for programs. Two messages are named after
    each: the text of the tile and, unless only time or a decision helps, what to check."""
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
        """The priority by the matrix, the same on every surface."""
        return MATRIX[self.rated]

    @property
    def texts(self) -> tuple[str, ...]:
        """The codes of its texts as an alarm: name, cause, consequence, response; none if it is no alarm."""
        parts = ("", "_cause", "_consequence", "_response") if self.is_alarm else ()
        return tuple(f"alarm_{self.code}{part}" for part in parts)
