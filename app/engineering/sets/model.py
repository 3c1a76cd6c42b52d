"""Parameter sets: the parameters of units as they were read, and the differences between two sets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, PlainSerializer

from app.core.web.shape import MessageObject, iso
from app.line.commands.values import in_measure
from app.line.live.api.view import Time
from app.line.live.bus_live import BusLive, UnitLive
from bus.catalogue.parameters import DECIMALS, FOLLOWER_MODE, PARAMETERS, Parameter
from bus.catalogue.values import StatusBits, is_follower, parameter_message, parameter_unit, status_bits
from bus.contract import ParameterValue
from bus.instants import UnixTime
from bus.messages import Message, term

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
    """A parameter as read from a unit: the ``raw`` value, the time, the frame.

    ``raw`` is None if the unit does not have the parameter (``available`` False), if it was never read, and
    if it is masked as a secret.
    """

    number: int
    raw: int | None
    available: bool = True
    read_at: UnixTime | None = None
    frame: bytes = b""


@dataclass(frozen=True, slots=True)
class UnitRows:
    """The parameters of one unit, by number; ``unit``: its address (#17), ``name``: its section."""

    unit: int
    name: str
    rows: Mapping[int, ParameterRow]

    def raw(self, number: int) -> int | None:
        """Return the raw value of a parameter, None if it is not known or not available."""
        row = self.rows.get(number)
        return None if row is None else row.raw


@dataclass(frozen=True, slots=True)
class SetHead:
    """The description of a stored set, without its units."""

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
    """The parameters of units, saved together. A stored set never changes; before that ``id`` is 0."""

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
        """Return the rows of one unit, None if the set lacks it."""
        return next((rows for rows in self.units if rows.unit == unit), None)


Comparison = Literal["equal", "differs", "unavailable", "unknown"]

_DIFFERENCES: dict[int, str] = {
    1: "differs_max_rpm",
    2: "differs_max_display",
    3: "differs_decimals",
    4: "differs_base_ratio",
    5: "differs_encoder",
    6: "differs_acceleration",
    7: "differs_deceleration",
    8: "differs_mode",
    12: "differs_window",
    17: "differs_address",
    18: "differs_baud",
    31: "differs_max_ratio",
    38: "differs_min_ratio",
}


@dataclass(frozen=True, slots=True)
class ParameterDifference:
    """A row of a comparison, as text and as raw values."""

    number: Number
    name: str
    kind: Comparison
    left: Annotated[MessageObject, Field(description="Value of the first set.")]
    right: Annotated[MessageObject, Field(description="Value of the second.")]
    left_raw: StoredRaw
    right_raw: StoredRaw
    meaning: Annotated[
        MessageObject | None, Field(description="What the difference means; null: the row does not differ.")
    ]


def rows_of(values: Iterable[ParameterValue]) -> dict[int, ParameterRow]:
    """Convert the values of responses to rows by number."""
    return {
        value.number: ParameterRow(value.number, value.raw, value.available, value.at, value.frame)
        for value in values
    }


def known_rows(unit: UnitLive) -> UnitRows:
    """Return the values of a live unit as last read, each with the time when it was."""
    return UnitRows(unit.settings.id, unit.settings.name, rows_of(unit.parameters.values()))


def status_of(bus: BusLive, unit: UnitLive) -> StatusBits | None:
    """Return a unit's inputs and mode as last read; None if it does not respond."""
    if unit.reading is None or unit.link.link in ("unknown", "offline"):
        return None
    return status_bits(unit.reading.outputs, unit.reading.inputs, bus.settings.estop_healthy)


def compare(left: UnitRows, right: UnitRows, tolerance: int = 0) -> list[ParameterDifference]:
    """Compare all 40 rows with ``left`` as the reference. ``tolerance``: raw counts that count as equal."""
    return [_compare_row(parameter, left, right, tolerance) for parameter in PARAMETERS.values()]


def differences(left: UnitRows, right: UnitRows, tolerance: int = 0) -> list[ParameterDifference]:
    """Return the rows that are known to differ, including rows that only one side has."""
    return [row for row in compare(left, right, tolerance) if row.kind in ("differs", "unavailable")]


def _compare_row(
    parameter: Parameter, left: UnitRows, right: UnitRows, tolerance: int
) -> ParameterDifference:
    number = parameter.number
    before, after = left.rows.get(number), right.rows.get(number)
    kind = _kind(before, after, tolerance)
    old, new = row_message(parameter, left), row_message(parameter, right)
    means = None
    if kind in ("differs", "unavailable"):
        means = meaning(number, old, new) if kind == "differs" else Message.of("differs", old=old, new=new)
    raws = (None, None) if parameter.secret else (left.raw(number), right.raw(number))
    return ParameterDifference(number, parameter.name, kind, old, new, *raws, means)


def meaning(number: int, old: Message, new: Message) -> Message:
    """Return a message of what it means that a parameter is ``new`` instead of ``old``."""
    if PARAMETERS[number].secret:
        return Message("differs_secret")
    return Message(_DIFFERENCES.get(number, "differs"), {"old": old, "new": new})


def _kind(left: ParameterRow | None, right: ParameterRow | None, tolerance: int) -> Comparison:
    if left is None or right is None:
        return "unknown"
    if not left.available and not right.available:
        return "equal"
    if left.raw is not None and right.raw is not None:
        return "equal" if abs(left.raw - right.raw) <= tolerance else "differs"
    return "unknown" if left.available and right.available else "unavailable"


def row_message(parameter: Parameter, rows: UnitRows) -> Message:
    """Return a row as text with its unit of measure; a secret is masked, a missing row marked."""
    row = rows.rows.get(parameter.number)
    if row is not None and not row.available:
        return Message("value_not_in_unit")
    if parameter.secret:
        return Message("value_secret")
    if row is None or row.raw is None:
        return Message("value_not_known")
    return with_unit(parameter, row.raw, rows)


def with_unit(parameter: Parameter, raw: int, rows: UnitRows) -> Message:
    """Return a raw value as text by #3 and #8 of ``rows``, with its measure: ``50`` of #6 is ``5.0 s``."""
    if raw in parameter.choices:
        return term(parameter.choices[raw])
    follower, unit = is_follower(rows.raw(FOLLOWER_MODE)), parameter_unit(parameter)
    value = parameter_message(parameter, raw, rows.raw(DECIMALS), follower=follower)
    return in_measure(value, term(unit) if unit else "")
