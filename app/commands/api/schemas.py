"""Members of the API's responses about commands, for its OpenAPI document."""

from __future__ import annotations

from typing import Annotated, NotRequired

from pydantic import Field
from typing_extensions import TypeAliasType, TypedDict

from app.web.shape import Instant, MaybeInstant, MessageShown, ReasonShown
from bus.contract import Direction, Outcome

OutcomeShown = TypeAliasType("OutcomeShown", Outcome)
"""Named, so that clients have one enumeration of it."""
Moment = Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds; null: it did not happen.")]
Attempts = Annotated[int, Field(description="How often the request was sent.")]


class FrameShown(TypedDict):
    """One frame as it passed the port."""

    at: Annotated[Instant, Field(description="ISO 8601 in UTC, milliseconds.")]
    direction: Annotated[Direction, Field(description="out: a request, in: a response.")]
    hex: Annotated[str, Field(description="The bytes on the wire, hexadecimal, separated by blanks.")]
    meaning: Annotated[str, Field(description="Its meaning, English.")]
    meanings: Annotated[list[MessageShown], Field(description="meaning as data.")]
    valid: Annotated[bool, Field(description="Whether it is a complete frame with the right checksum.")]


class OutcomeMembers(ReasonShown):
    """What became of a command, or of its part at one unit."""

    outcome: OutcomeShown
    read_back: Annotated[
        int | None,
        Field(description="Raw value that the unit was read to have; null: not read, or a secret."),
    ]
    unit_error: Annotated[int | None, Field(description="Error code of a NAK, 128 to 137; null: no NAK.")]
    unit_error_name: str | None


class UnitResult(OutcomeMembers):
    """The outcome at one unit, with the times of its frames."""

    unit: Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")]
    sent_at: Moment
    acknowledged_at: Moment
    proven_at: Moment
    attempts: Attempts


class CommandResult(OutcomeMembers):
    """The one outcome of a command; where it is about one unit, also that unit's times."""

    code: Annotated[OutcomeShown, Field(description="As outcome; problems have it too.")]
    id: Annotated[str, Field(description="Of the command: the Idempotency-Key where one was sent.")]
    at: Annotated[Instant, Field(description="When the outcome was known, ISO 8601 in UTC, milliseconds.")]
    bus: str
    unit: Annotated[int | None, Field(description="Address of the one unit it is about; null: several.")]
    skew_s: Annotated[
        float | None,
        Field(
            description="Longest time between the first and the last unit's acting on one broadcast, seconds."
        ),
    ]
    units: Annotated[
        dict[str, UnitResult],
        Field(description="The outcome at each unit of a command to several, by its address."),
    ]
    frames: NotRequired[
        Annotated[
            list[FrameShown],
            Field(description="With frames=true: what carried the command; empty for a secret."),
        ]
    ]
    sent_at: NotRequired[Moment]
    acknowledged_at: NotRequired[Moment]
    proven_at: NotRequired[Moment]
    attempts: NotRequired[Attempts]


class TraceShown(TypedDict):
    """The last frames of a bus, oldest first."""

    bus: str
    frames: list[FrameShown]


class CommandBlockShown(TypedDict):
    """Whether commands to a unit are blocked."""

    blocked: bool
    reason: str | None
    by: Annotated[str | None, Field(description="Who blocked it; null: it is not blocked.")]
    since: Moment


class ControlShown(TypedDict):
    """Who has control of a line."""

    required: Annotated[bool, Field(description="Whether commands need control (control in [site]).")]
    lapses_after_s: Annotated[
        float, Field(description="Control without a command lapses after this, seconds.")
    ]
    holder: Annotated[str | None, Field(description="Name of the user or token; null: control is free.")]
    is_token: Annotated[bool | None, Field(description="Whether the holder is a token.")]
    since: Moment
    lapses_at: Moment
