"""What the units said and how they are: from the worker to the app."""

from __future__ import annotations

from msgspec import Struct, field

from bus.clauses import Clause, in_english
from bus.contract.message import BusLinkState, Direction, Message, UnitLinkState


class Reading(Message, frozen=True, tag="reading"):
    """One answer to 81h. ``analog`` is ATD, ``outputs`` is ST2, ``inputs`` is ST1, all as sent."""

    unit: int
    at: float
    commanded: int
    actual: int
    analog: int
    outputs: int
    inputs: int


class ParameterValue(Message, frozen=True, tag="parameter"):
    """What 85h answered, and the very frame that said so (``frame``, as on the wire, for evidence).
    ``available`` False: the unit said NAK 82h, it does not have this one."""

    unit: int
    number: int
    at: float
    raw: int | None
    available: bool = True
    frame: bytes = b""


class UnitLink(Message, frozen=True, tag="unit_link"):
    """A unit was heard, is overdue, was lost or was never seen."""

    unit: int
    at: float
    link: UnitLinkState
    cause: str = ""


class BusLink(Message, frozen=True, tag="bus_link"):
    """The port was opened or closed ``at``; ``cause`` says why in words. Told again, with the same ``at``,
    when it goes at another rate."""

    at: float
    link: BusLinkState
    cause: str = ""
    baud: int = 0
    """The rate that the port goes at now, which a change of #18 may have moved; 0 from an older worker."""


class Staged(Message, frozen=True, tag="staged"):
    """The speed a unit has acknowledged by 82h and not yet executed; None once executed or withdrawn."""

    unit: int
    at: float
    raw: int | None


class UnitState(Message, frozen=True, tag="unit_state"):
    """All that the worker knows of one unit now."""

    unit: int
    link: UnitLink
    reading: Reading | None = None
    parameters: list[ParameterValue] = field(default_factory=list)
    staged: int | None = None


class UnitCounts(Struct, omit_defaults=True):
    """What became of every request to one unit since the worker started; the worker counts in it."""

    unit: int
    polls: int = 0
    answers: int = 0
    timeouts: int = 0
    retries: int = 0
    checksum_errors: int = 0
    foreign: int = 0
    late: int = 0
    naks: dict[int, int] = field(default_factory=dict)


# Frozen, as it is told, of what is counted in: msgspec allows that, the rule is for dataclasses.
class UnitFigures(UnitCounts, Message, frozen=True, tag="unit_figures"):  # type: ignore[misc]
    """The counters of one unit, and its answer times in seconds (first byte after request)."""

    answer_s_min: float | None = None
    answer_s_median: float | None = None
    answer_s_p99: float | None = None
    answer_s_max: float | None = None


class BusFigures(Message, frozen=True, tag="bus_figures"):
    """What the wire carries, about once a second. ``diagnosis`` is the likely cause of trouble in words."""

    at: float
    scan_hz: float
    scan_s: float
    wire_utilisation: float
    scan_s_with_one_more: float
    noise_bytes: int = 0
    echoes: int = 0
    diagnosis: str = ""
    units: list[UnitFigures] = field(default_factory=list)
    updates_lost: int = 0
    """Readings and news dropped because the app was away longer than the worker can keep them."""
    answers_for_all: int = 0
    """The unit that seems to answer to every address beside the others, so that each answer of theirs comes
    twice and nobody knows which one is whose; 0: none."""


class Frame(Message, frozen=True, tag="frame"):
    """One frame (or piece of rubbish) as it passed the port, with what it says."""

    at: float
    direction: Direction
    data: bytes
    clauses: list[Clause]
    valid: bool = True

    @property
    def meaning(self) -> str:
        """What it says, in English."""
        return in_english(self.clauses)


class Frames(Message, frozen=True, tag="frames"):
    """Trace, sent only while someone follows it."""

    frames: list[Frame]
