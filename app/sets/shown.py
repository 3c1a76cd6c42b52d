"""Members of the API's responses about parameter sets, for its OpenAPI document."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import TypedDict

from app.live.api.schemas import MaybeTime, Time, UnitAddress
from app.sets.compare import Comparison
from app.web.message_shown import MaybeMessage, MessageShown

Number = Annotated[int, Field(description="Number of the parameter, 1 to 40.")]
StoredRaw = Annotated[
    int | None, Field(description="Integer on the wire; null: not known, or a secret (#21).")
]


class SetHead(TypedDict):
    """The first members of every response about a set."""

    id: int
    bus: str
    name: str
    comment: str
    taken_at: Time
    who: str
    origin: Annotated[str, Field(description="Origin: by hand, on schedule, before the first write …")]
    golden_for: Annotated[list[int], Field(description="Addresses of the units whose golden set it is.")]


class SummaryShown(SetHead):
    """A stored parameter set without its values."""

    units: Annotated[list[int], Field(description="Addresses of its units.")]


class SetParameterShown(TypedDict):
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


class SetUnitShown(TypedDict):
    """One unit in a set."""

    id: UnitAddress
    name: str
    parameters: list[SetParameterShown]


class SetShown(SetHead):
    """A stored parameter set with its values."""

    units: list[SetUnitShown]


class GoldenShown(TypedDict):
    """The golden set of a unit."""

    set: int
    unit: UnitAddress
    golden: bool


class ComparedShown(TypedDict):
    """One row of a comparison."""

    number: Number
    name: str
    kind: Comparison
    left: Annotated[str, Field(description="Value of the first set, as shown to people.")]
    left_message: MessageShown
    right: Annotated[str, Field(description="Value of the second.")]
    right_message: MessageShown
    left_raw: StoredRaw
    right_raw: StoredRaw
    meaning: Annotated[str, Field(description="What the difference means, English; empty: none.")]
    meaning_message: MaybeMessage


class DepartureShown(ComparedShown):
    """A row in which a unit differs from its golden set, and whose change it is."""

    changed_by: Annotated[str | None, Field(description="User or token; null: changed at the panel.")]
    changed_at: MaybeTime
    changed: Annotated[str, Field(description="at the panel, or by whom.")]
    changed_message: MessageShown


class DriftShown(TypedDict):
    """Where a unit as last read differs from its golden set."""

    golden: Annotated[bool, Field(description="Whether it has a golden set.")]
    unread: Annotated[int, Field(description="How many parameters could not be compared yet, 0 to 40.")]
    rows: list[DepartureShown]


class OverdueShown(TypedDict):
    """A unit whose set of the day could not be saved yet."""

    unit: UnitAddress
    why: Annotated[str, Field(description="Why, English.")]
    why_message: MaybeMessage


class ScheduleShown(TypedDict):
    """When the sets of a bus are saved."""

    minute_of_day: Annotated[int | None, Field(description="Local time, 0 to 1439; null: not by schedule.")]
    overdue: list[OverdueShown]
