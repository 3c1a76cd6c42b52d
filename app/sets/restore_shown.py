"""Members of the API's responses about restores, for its OpenAPI document."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import TypedDict

from app.live.api.schemas import UnitAddress
from app.sets.effects import Effect
from app.sets.plan import Reason
from app.sets.restore_record import RestoreState
from app.sets.shown import ComparedShown, Number, StoredRaw
from app.web.message_shown import MaybeMessage, MessageShown
from bus.contract import Outcome

MaybeReason = Annotated[
    Reason | None, Field(description="The reason, for programs; null: none, or noted by an earlier version.")
]


class RestoreValues(TypedDict):
    """A row as the unit has it and as the set has it."""

    number: Number
    name: str
    present_raw: StoredRaw
    wanted_raw: StoredRaw
    present: Annotated[str | None, Field(description="As shown to people; null: not known.")]
    present_message: MaybeMessage
    wanted: Annotated[str | None, Field(description="As shown to people; null: not known.")]
    wanted_message: MaybeMessage


class RestoreRowShown(RestoreValues):
    """A row that differs and can be written."""

    selected: Annotated[bool, Field(description="Whether this restore writes it.")]
    reason: Annotated[str | None, Field(description="Why it is not selected; null: it is.")]
    reason_code: MaybeReason
    reason_message: MaybeMessage
    effect: Annotated[Effect | None, Field(description="Effect of the write on a running unit; null: none.")]
    warning: Annotated[
        str | None, Field(description="The effect in words, where the unit runs or may run; null: none.")
    ]
    warning_message: MaybeMessage
    words: Annotated[str, Field(description="Effect of the change, a template for old and new.")]
    meaning: Annotated[str, Field(description="Effect of the change.")]
    meaning_message: MaybeMessage
    outcome: Annotated[Outcome | None, Field(description="null: not written yet.")]
    message: Annotated[str, Field(description="What became of it, English; empty: nothing more.")]
    outcome_message: Annotated[MessageShown | None, Field(description="message as data.")]
    read_back: StoredRaw


class LeftOutShown(RestoreValues):
    """A row that a restore does not write."""

    reason: Annotated[str, Field(description="Why it is not written.")]
    reason_code: MaybeReason
    reason_message: MaybeMessage
    later: Annotated[
        bool, Field(description="Whether the same restore writes it once the unit is in REMOTE.")
    ]
    differs: Annotated[bool | None, Field(description="null: not known, as one side is not.")]


class RestoreShown(TypedDict):
    """A restore: its plan, its progress, and the result of the full read afterwards. In state ``equal``
    the unit equals the set in all rows selected."""

    id: str
    bus: str
    unit: UnitAddress
    who: str
    state: RestoreState
    cause: Annotated[str, Field(description="Why it stopped; empty: it did not.")]
    cause_code: Annotated[str | None, Field(description="The cause, for programs; null: it did not stop.")]
    cause_message: Annotated[MessageShown | None, Field(description="cause as data.")]
    running: Annotated[
        bool | None, Field(description="The Run input when the restore was planned; null: not known.")
    ]
    done: Annotated[int, Field(description="Rows that have an outcome.")]
    equal: Annotated[int, Field(description="Rows that were equal beforehand.")]
    remarks: list[str]
    remark_messages: Annotated[list[MessageShown], Field(description="Each of the remarks as data.")]
    rows: list[RestoreRowShown]
    left_out: list[LeftOutShown]
    remaining: Annotated[
        list[ComparedShown] | None, Field(description="Rows that still differ; null: not read back yet.")
    ]
