"""Restores as pages and programs see them, with the schemas of the API. #21 never leaves here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field
from typing_extensions import TypedDict

from app.live.api.schemas import UnitAddress
from app.sets.compare import meaning, with_unit
from app.sets.effects import EFFECTS, Effect, warning_of
from app.sets.model import UnitRows
from app.sets.plan import LeftOut, Reason
from app.sets.restore_record import Restore, RestoreState, RowResult
from app.sets.view import Number, ParameterDifference, StoredRaw, compared_json
from app.web.shape import MaybeMessage, MessageShown, maybe_shown, message_shown
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Outcome
from bus.messages import Message, in_english

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


class RestoreOmission(RestoreValues):
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
    left_out: list[RestoreOmission]
    remaining: Annotated[
        list[ParameterDifference] | None,
        Field(description="Rows that still differ; null: not read back yet."),
    ]


@dataclass(frozen=True, slots=True)
class RestoreRow:
    """A row as the unit has it and as the set has it; None where a value is not known. ``left``: why it is
    not written, None: it is. ``result``: what became of it, None where it cannot be chosen."""

    number: int
    present_raw: int | None
    wanted_raw: int | None
    present: Message | None
    wanted: Message | None
    left: LeftOut | None
    result: RowResult | None = None
    warning: Message | None = None

    @property
    def name(self) -> str:
        return PARAMETERS[self.number].name

    @property
    def effect(self) -> Effect | None:
        """What writing it does to a running unit."""
        return EFFECTS.get(self.number)

    @property
    def meaning(self) -> Message:
        unknown = Message("value_not_known")
        return meaning(self.number, self.present or unknown, self.wanted or unknown)


def rows_to_write(restore: Restore) -> list[RestoreRow]:
    """The rows that are written; of a plan those that can still be chosen too."""
    offered = restore.offered if restore.state == "planned" else []
    chosen = [_row(restore, row.write.number, None, row) for row in restore.rows]
    return chosen + [_row(restore, left.number, left, RowResult(write)) for write, left in offered]


def rows_left_out(restore: Restore) -> list[RestoreRow]:
    return [_row(restore, left.number, left) for left in restore.left_out]


def restore_json(restore: Restore) -> RestoreShown:
    return {
        "id": restore.id,
        "bus": restore.bus,
        "unit": restore.unit,
        "who": restore.who,
        "state": restore.state,
        "cause": in_english(restore.cause),
        "cause_code": restore.cause_code,
        "cause_message": maybe_shown(restore.cause),
        "running": restore.running,
        "done": restore.done,
        "equal": restore.plan.equal,
        "remarks": [str(remark) for remark in restore.remarks],
        "remark_messages": [message_shown(remark) for remark in restore.remarks],
        "rows": [_row_json(row, row.result) for row in rows_to_write(restore) if row.result],
        "left_out": [_left_out_json(row, row.left) for row in rows_left_out(restore) if row.left],
        "remaining": None if restore.remaining is None else [compared_json(row) for row in restore.remaining],
    }


def _row(restore: Restore, number: int, left: LeftOut | None, result: RowResult | None = None) -> RestoreRow:
    raw = restore.before.raw(number), restore.wanted.raw(number)
    texts = _shown(restore.before, number), _shown(restore.wanted, number)
    warning = warning_of(number, result.write.wanted, running=restore.running) if result else None
    return RestoreRow(number, *raw, *texts, left, result, warning)


def _shown(rows: UnitRows, number: int) -> Message | None:
    parameter, raw = PARAMETERS[number], rows.raw(number)
    if parameter.secret:
        return Message("value_secret")
    return None if raw is None else with_unit(parameter, raw, rows)


def _row_json(row: RestoreRow, result: RowResult) -> RestoreRowShown:
    left = row.left
    return {
        **_values_json(row),
        "selected": left is None,
        "reason": None if left is None else str(left.text),
        "reason_code": None if left is None else left.reason,
        "reason_message": None if left is None else message_shown(left.text),
        "effect": row.effect,
        "warning": None if row.warning is None else str(row.warning),
        "warning_message": maybe_shown(row.warning),
        "words": str(Message(row.meaning.code)),
        "meaning": str(row.meaning),
        "meaning_message": message_shown(row.meaning),
        "outcome": result.outcome,
        "message": in_english(result.message),
        "outcome_message": maybe_shown(result.message),
        "read_back": None if PARAMETERS[row.number].secret else result.read_back,
    }


def _left_out_json(row: RestoreRow, left: LeftOut) -> RestoreOmission:
    unknown = row.present_raw is None or row.wanted_raw is None
    return {
        **_values_json(row),
        "reason": str(left.text),
        "reason_code": left.reason,
        "reason_message": message_shown(left.text),
        "later": left.later,
        "differs": None if unknown else row.present_raw != row.wanted_raw,
    }


def _values_json(row: RestoreRow) -> RestoreValues:
    secret = PARAMETERS[row.number].secret
    return {
        "number": row.number,
        "name": row.name,
        "present_raw": None if secret else row.present_raw,
        "wanted_raw": None if secret else row.wanted_raw,
        "present": None if row.present is None else str(row.present),
        "present_message": maybe_shown(row.present),
        "wanted": None if row.wanted is None else str(row.wanted),
        "wanted_message": maybe_shown(row.wanted),
    }
