"""Sets and comparisons as the API returns them, with their schemas. #21 never leaves here."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

from pydantic import Field
from typing_extensions import TypedDict

from app.live.api.schemas import MaybeTime, UnitAddress
from app.sets.compare import ParameterDifference, with_unit
from app.sets.drift import DriftedParameter
from app.sets.model import Number, ParameterSet, SetHead, StoredRaw, UnitRows
from app.web.shape import MessageObject, iso
from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message


class ParameterSetParameter(TypedDict):
    """One parameter in a set."""

    number: Number
    name: str
    raw: StoredRaw
    value: Annotated[str | None, Field(description="As shown to people; null: not known, or a secret.")]
    available: Annotated[bool, Field(description="Whether the unit has it.")]
    read_at: MaybeTime
    frame: Annotated[
        str | None, Field(description="The response with the value, hexadecimal; null: a secret.")
    ]


class ParameterSetUnit(TypedDict):
    """One unit in a set."""

    id: UnitAddress
    name: str
    parameters: list[ParameterSetParameter]


@dataclass(frozen=True, slots=True)
class ParameterSetShown(SetHead):
    """A stored parameter set with its values."""

    units: list[ParameterSetUnit]


class GoldenSet(TypedDict):
    """The golden set of a unit."""

    set: int
    unit: UnitAddress
    golden: bool


@dataclass(frozen=True, slots=True)
class DriftRow(ParameterDifference):
    """A row in which a unit differs from its golden set, and whose change it is."""

    changed_by: Annotated[str | None, Field(description="User or token; null: changed at the panel.")]
    changed_at: MaybeTime
    changed: Annotated[MessageObject, Field(description="at the panel, or by whom.")]


class DriftShown(TypedDict):
    """Where a unit as last read differs from its golden set."""

    golden: Annotated[bool, Field(description="Whether it has a golden set.")]
    unread: Annotated[int, Field(description="How many parameters could not be compared yet, 0 to 40.")]
    rows: list[DriftRow]


class OverdueSave(TypedDict):
    """A unit whose set of the day could not be saved yet."""

    unit: UnitAddress
    why: Annotated[MessageObject | None, Field(description="Why.")]


class SaveSchedule(TypedDict):
    """When the sets of a bus are saved."""

    minute_of_day: Annotated[int | None, Field(description="Local time, 0 to 1439; null: not by schedule.")]
    overdue: list[OverdueSave]


def set_json(stored: ParameterSet) -> ParameterSetShown:
    """A complete set; secrets masked."""
    return ParameterSetShown(
        id=stored.id,
        bus=stored.bus,
        name=stored.name,
        comment=stored.comment,
        taken_at=stored.taken_at,
        who=stored.who,
        origin=stored.origin,
        golden_for=tuple(sorted(stored.golden_for)),
        units=[_unit_json(rows) for rows in stored.units],
    )


def _unit_json(rows: UnitRows) -> ParameterSetUnit:
    parameters: list[ParameterSetParameter] = []
    for number, row in sorted(rows.rows.items()):
        parameter = PARAMETERS[number]
        raw = None if parameter.secret else row.raw
        parameters.append(
            {
                "number": number,
                "name": parameter.name,
                "raw": raw,
                "value": None if raw is None else str(with_unit(parameter, raw, rows)),
                "available": row.available,
                "read_at": None if row.read_at is None else iso(row.read_at),
                "frame": None if parameter.secret else row.frame.hex(" "),
            }
        )
    return {"id": rows.unit, "name": rows.name, "parameters": parameters}


def departure_json(departure: DriftedParameter) -> DriftRow:
    """A row of a comparison with the golden set, and whose change it is."""
    change = departure.change
    row: dict[str, Any] = {each.name: getattr(departure.row, each.name) for each in fields(departure.row)}
    return DriftRow(
        **row,
        changed_by=None if change is None else change["who"],
        changed_at=None if change is None else iso(change["time"]),
        changed=Message("changed_at_panel")
        if change is None
        else Message.of("changed_by", who=change["who"]),
    )
