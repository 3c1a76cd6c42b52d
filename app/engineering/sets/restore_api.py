"""The HTTP API of restores: plan, start, follow; and its schemas. The value of #21 is never shown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import Field
from typing_extensions import TypedDict

from app.core.web.access import Person, Viewer
from app.core.web.api import ApiRoute, problems
from app.core.web.request_rules import MAX_BODY_BYTES
from app.core.web.shape import MessageObject, Numbers, StrictBody
from app.engineering.sets.lookup import (
    KnownRestore,
    Restores,
    Sets,
    document_rows,
    set_or_404,
    unit_rows_or_404,
)
from app.engineering.sets.model import Number, ParameterDifference, StoredRaw, UnitRows, meaning, with_unit
from app.engineering.sets.restore_plan import (
    LeftOut,
    Reason,
    Restore,
    RestoreState,
    RowResult,
    Selection,
)
from app.engineering.sets.restore_service import CANCEL, PLAN, START
from app.errors import Problem
from app.line.commands.effects import EFFECTS, Effect, warning_of
from app.line.live.api.routes import Live
from app.line.live.api.view import UnitAddress
from app.line.live.requests import unit_or_404
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Outcome
from bus.messages import Message, term

MaybeReason = Annotated[
    Reason | None, Field(description="The reason, for programs; null: none, or noted by an earlier version.")
]
MaybeValue = Annotated[MessageObject | None, Field(description="As shown to people; null: not known.")]


@dataclass(frozen=True, slots=True)
class RestoreValues:
    """The values of a parameter in the unit and in the set."""

    number: Number
    name: str
    present_raw: StoredRaw
    wanted_raw: StoredRaw
    present: MaybeValue
    wanted: MaybeValue


@dataclass(frozen=True, slots=True)
class RestoreRow(RestoreValues):
    """A row that differs and can be written."""

    selected: Annotated[bool, Field(description="Whether this restore writes it.")]
    reason: Annotated[MessageObject | None, Field(description="Why it is not selected; null: it is.")]
    reason_code: MaybeReason
    effect: Annotated[Effect | None, Field(description="Effect of the write on a running unit; null: none.")]
    warning: Annotated[
        MessageObject | None,
        Field(description="The effect in words, where the unit runs or may run; null: none."),
    ]
    meaning: Annotated[MessageObject, Field(description="Effect of the change.")]
    outcome: Annotated[Outcome | None, Field(description="null: not written yet.")]
    message: Annotated[MessageObject | None, Field(description="What became of it; null: nothing more.")]
    read_back: StoredRaw


@dataclass(frozen=True, slots=True)
class RestoreOmission(RestoreValues):
    """A row that a restore does not write."""

    reason: Annotated[MessageObject, Field(description="Why it is not written.")]
    reason_code: MaybeReason
    later: Annotated[
        bool, Field(description="Whether the same restore writes it once the unit is in REMOTE.")
    ]
    differs: Annotated[bool | None, Field(description="null: not known, as one side is not.")]


class RestoreShown(TypedDict):
    """A restore: its plan, its progress, and the result of the full read at its end. In the state ``equal``
    the unit equals the set in all selected rows."""

    id: str
    bus: str
    unit: UnitAddress
    who: str
    state: RestoreState
    cause: Annotated[MessageObject | None, Field(description="Why it stopped; null: it did not.")]
    cause_code: Annotated[str | None, Field(description="The cause, for programs; null: it did not stop.")]
    running: Annotated[
        bool | None, Field(description="The Run input when the restore was planned; null: not known.")
    ]
    done: Annotated[int, Field(description="Rows that have an outcome.")]
    equal: Annotated[int, Field(description="Rows that were equal beforehand.")]
    remarks: list[MessageObject]
    rows: list[RestoreRow]
    left_out: list[RestoreOmission]
    remaining: Annotated[
        list[ParameterDifference] | None,
        Field(description="Rows that still differ; null: not read back yet."),
    ]


def rows_to_write(restore: Restore) -> list[RestoreRow]:
    """Return the rows that are written and, in a plan, those that can still be chosen."""
    offered = restore.offered if restore.state == "planned" else []
    chosen = [_row(restore, row, None) for row in restore.rows]
    return chosen + [_row(restore, RowResult(write), left) for write, left in offered]


def rows_left_out(restore: Restore) -> list[RestoreOmission]:
    rows: list[RestoreOmission] = []
    for left in restore.left_out:
        present, wanted = restore.before.raw(left.number), restore.wanted.raw(left.number)
        differs = None if present is None or wanted is None else present != wanted
        values = _values(restore, left.number)
        rows.append(
            RestoreOmission(
                **values, reason=left.text, reason_code=left.reason, later=left.later, differs=differs
            )
        )
    return rows


def _restore_json(restore: Restore) -> RestoreShown:
    return {
        "id": restore.id,
        "bus": restore.bus,
        "unit": restore.unit,
        "who": restore.who,
        "state": restore.state,
        "cause": restore.cause,
        "cause_code": restore.cause_code,
        "running": restore.running,
        "done": restore.done,
        "equal": restore.plan.equal,
        "remarks": restore.remarks,
        "rows": rows_to_write(restore),
        "left_out": rows_left_out(restore),
        "remaining": restore.remaining,
    }


def _row(restore: Restore, result: RowResult, left: LeftOut | None) -> RestoreRow:
    number, unknown = result.write.number, Message("value_not_known")
    values = _values(restore, number)
    return RestoreRow(
        **values,
        selected=left is None,
        reason=None if left is None else left.text,
        reason_code=None if left is None else left.reason,
        effect=EFFECTS.get(number),
        warning=warning_of(number, result.write.wanted, running=restore.running),
        meaning=meaning(number, values["present"] or unknown, values["wanted"] or unknown),
        outcome=result.outcome,
        message=result.message,
        read_back=None if PARAMETERS[number].secret else result.read_back,
    )


def _values(restore: Restore, number: int) -> dict[str, Any]:
    secret = PARAMETERS[number].secret
    return {
        "number": number,
        "name": PARAMETERS[number].name,
        "present_raw": None if secret else restore.before.raw(number),
        "wanted_raw": None if secret else restore.wanted.raw(number),
        "present": _shown(restore.before, number),
        "wanted": _shown(restore.wanted, number),
    }


def _shown(rows: UnitRows, number: int) -> Message | None:
    parameter, raw = PARAMETERS[number], rows.raw(number)
    if parameter.secret:
        return Message("value_secret")
    return None if raw is None else with_unit(parameter, raw, rows)


router = APIRouter(prefix="/api/v1", tags=["parameter sets"], route_class=ApiRoute)

Planner = Annotated[Person, PLAN.permitted]
Included = Annotated[
    Numbers, Field(description="rows that are left out unless named: the setpoints #20 and #37")
]
Excluded = Annotated[Numbers, Field(description="rows not to write")]


class RestoreRequest(StrictBody):
    """The source of a restore: a stored set, or a TOML document with one unit (or with this one). ``ticked``:
    the dangerous rows (#18, #19, #27) to write, each confirmed by its number."""

    set: int | None = None
    document: str | None = None
    from_unit: int | None = None
    include: Annotated[Included, Field(default_factory=list)]
    exclude: Annotated[Excluded, Field(default_factory=list)]
    ticked: Annotated[Numbers, Field(default_factory=list)]


class StartRestoreRequest(StrictBody):
    """The rows to write, if not those of the plan; a member that is left out or null stays as planned."""

    include: Included | None = None
    exclude: Excluded | None = None


@router.post(
    "/buses/{bus}/units/{unit}/restores",
    status_code=201,
    responses=problems(504),
    max_body_size=MAX_BODY_BYTES,
)
async def plan_restore(
    person: Planner,
    sets: Sets,
    restores: Restores,
    live: Live,
    bus: str,
    unit: int,
    wanted: RestoreRequest,
) -> RestoreShown:
    """Read the unit and list the rows that a restore would write. Nothing is written."""
    unit_or_404(live, bus, unit)
    selection = Selection(frozenset(wanted.include), frozenset(wanted.exclude), frozenset(wanted.ticked))
    rows = await _wanted_rows(sets, unit, wanted)
    return _restore_json(await restores.plan(person, bus, unit, rows, selection))


@router.post("/restores/{restore_id}/start", status_code=202)
async def start_restore(
    person: Annotated[Person, START.permitted],
    restores: Restores,
    restore: KnownRestore,
    chosen: StartRestoreRequest | None = None,
) -> RestoreShown:
    """Write the selected rows, unless the unit has changed since the plan."""
    if chosen is not None and (chosen.include is not None or chosen.exclude is not None):
        planned = restore.selection
        include = planned.include if chosen.include is None else frozenset(chosen.include)
        exclude = planned.exclude if chosen.exclude is None else frozenset(chosen.exclude)
        restores.select(person, restore, planned.choosing(include, exclude))
    restores.start(person, restore)
    return _restore_json(restore)


@router.post("/restores/{restore_id}/cancel", status_code=202)
async def cancel_restore(
    person: Annotated[Person, CANCEL.permitted], restores: Restores, restore: KnownRestore
) -> RestoreShown:
    """Stop a restore after its current row."""
    restores.cancel(person, restore)
    return _restore_json(restore)


@router.get("/restores/{restore_id}")
async def get_restore(_: Viewer, restore: KnownRestore) -> RestoreShown:
    """Return the progress of the restore, row by row."""
    return _restore_json(restore)


async def _wanted_rows(sets: Sets, unit: int, wanted: RestoreRequest) -> UnitRows:
    """Return the rows that the unit shall have. Raise Problem 422 or 404."""
    if (wanted.set is None) == (wanted.document is None):
        raise Problem(422, "invalid", Message("set_or_document"))
    if wanted.set is not None:
        return unit_rows_or_404(await set_or_404(sets, wanted.set), wanted.from_unit or unit)
    return await document_rows(wanted.document or "", term("the document"), unit, wanted.from_unit)
