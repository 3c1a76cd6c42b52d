"""What a parameter set is: the parameters of one or several units, as they were read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, PlainSerializer

from app.core.web.api.shape import iso
from app.line.live.api.schemas import Time
from bus.instants import UnixTime

Number = Annotated[int, Field(description="Number of the parameter, 1 to 40.")]
StoredRaw = Annotated[
    int | None, Field(description="Integer on the wire; null: not known, or a secret (#21).")
]
SetOrigin = Literal[
    "by hand",
    "on schedule",
    "before the first write of the day",
    "after the first write of the day",
    "from a file",
    "from the sheet",
    "for a unit swap",
]


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One parameter as a unit gave it: ``raw`` on the wire, when it was read, by which frame.

    ``raw`` None with ``available`` False: the unit does not have it. ``raw`` None otherwise: not
    known here (never read, or masked because it is secret).
    """

    number: int
    raw: int | None
    available: bool = True
    read_at: UnixTime | None = None
    frame: bytes = b""


@dataclass(frozen=True, slots=True)
class UnitRows:
    """The rows of one unit; ``unit`` is its address (#17), ``name`` its section."""

    unit: int
    name: str
    rows: Mapping[int, ParameterRow]

    def raw(self, number: int) -> int | None:
        """The raw value of one parameter, None when it is not known or not there."""
        row = self.rows.get(number)
        return None if row is None else row.raw


@dataclass(frozen=True, slots=True)
class SetHead:
    """The first members of a stored set, without its values."""

    id: int
    bus: str
    name: str
    comment: str
    taken_at: Annotated[UnixTime, PlainSerializer(iso, return_type=Time)]
    who: str
    origin: Annotated[str, Field(description="Origin: by hand, on schedule, before the first write …")]
    golden_for: Annotated[
        tuple[int, ...], Field(description="Addresses of the units whose golden set it is.")
    ]


@dataclass(frozen=True, slots=True)
class ParameterSetSummary(SetHead):
    """A stored parameter set without its values."""

    units: Annotated[tuple[int, ...], Field(description="Addresses of its units.")]


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """Immutable once stored; ``id`` 0 before that. ``taken_at`` seconds since the epoch."""

    bus: str
    taken_at: UnixTime
    who: str
    origin: SetOrigin
    units: tuple[UnitRows, ...]
    name: str = ""
    comment: str = ""
    id: int = 0
    golden_for: tuple[int, ...] = ()

    def unit(self, unit: int) -> UnitRows | None:
        """The rows of one unit of the set."""
        return next((rows for rows in self.units if rows.unit == unit), None)
