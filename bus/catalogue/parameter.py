"""One parameter: its evidence, and which values it may be given.

Marks of evidence: A stated in the manual, B stated for the sibling DFS-1 and consistent, C inferred, U
unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from bus.errors import CallerError
from bus.messages import Message

DataType = Literal["UCHR", "UINT", "ULNG"]
Evidence = Literal["A", "B", "C", "U"]


class Scale(StrEnum):
    """How the integer on the wire becomes the number that people use."""

    PLAIN = "plain"
    SPEED = "speed"
    """Display units with #3 decimals."""
    SPEED_OR_RATIO = "speed or ratio"
    """Display units in a master; in a follower a ratio with four decimals."""
    RATIO = "ratio"
    """Four implied decimals: 10000 is 1.0000."""
    TENTHS = "tenths of a second"
    BAUD = "hundreds of baud"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One row. Ranges are raw integers, both ends included."""

    number: int
    name: str
    type: DataType
    minimum: int
    maximum: int
    evidence: Evidence
    """Of the meaning and the scale; number, name, type and range are always A."""
    group: str
    meaning: str
    scale: Scale = Scale.PLAIN
    unit: str = ""
    """Unit of the engineering value where it is the same for every drive."""
    choices: Mapping[int, str] = field(default_factory=dict, hash=False)
    allowed: frozenset[int] | None = None
    """The only legal values where the range has holes."""
    never_writable: bool = False
    dangerous: str = ""
    """What a write can do to the link; empty where it is harmless to it."""
    harmless: frozenset[int] = frozenset()
    """Values of a dangerous parameter that cannot have the effect in ``dangerous``."""
    secret: bool = False
    not_while_running: bool = False
    """The unit allows no change during RUN."""


class IllegalValue(CallerError):
    """A value that a parameter cannot take; ``nearest`` is the closest that it can."""

    def __init__(self, message: Message, nearest: int) -> None:
        super().__init__(message)
        self.nearest = nearest


def danger_of_writing(parameter: Parameter, raw: int) -> str:
    """Return what writing ``raw`` can do to the link; empty where it is harmless to it."""
    return "" if raw in parameter.harmless else parameter.dangerous


def check_writable_value(parameter: Parameter, raw: int) -> None:
    """Raises CallerError for a parameter that is never written, IllegalValue for a value out of range."""
    if parameter.never_writable:
        raise CallerError(Message.of("parameter_not_by_link", number=parameter.number, called=parameter.name))
    nearest = nearest_legal(parameter, raw)
    if nearest != raw:
        raise IllegalValue(_refusal(parameter, raw, nearest), nearest)


def _refusal(parameter: Parameter, raw: int, nearest: int) -> Message:
    legal = _legal_values(parameter)
    if parameter.secret:
        # The message goes into the log, and what was typed may be the secret but for one digit too many.
        return Message.of("parameter_takes", number=parameter.number, called=parameter.name, values=legal)
    return Message.of(
        "parameter_cannot_be",
        number=parameter.number,
        called=parameter.name,
        raw=raw,
        values=legal,
        nearest=nearest,
    )


def nearest_legal(parameter: Parameter, raw: int) -> int:
    """The value closest to ``raw`` that the parameter takes; of two equally close the smaller."""
    if parameter.allowed is not None:
        return min(sorted(parameter.allowed), key=lambda legal: abs(legal - raw))
    return min(max(raw, parameter.minimum), parameter.maximum)


def _legal_values(parameter: Parameter) -> Message:
    if parameter.allowed is None:
        return Message.of("value_range", lowest=parameter.minimum, highest=parameter.maximum)
    *others, last = sorted(parameter.allowed)
    return Message.of("one_of_values", others=list(others), last=last)
