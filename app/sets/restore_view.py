"""Restores as JSON. #21 never leaves here."""

from __future__ import annotations

from app.sets.compare import meaning, with_unit
from app.sets.effects import EFFECTS, warning_of
from app.sets.model import UnitRows
from app.sets.plan import LeftOut
from app.sets.restore_record import Restore, RowResult
from app.sets.restore_shown import LeftOutShown, RestoreRowShown, RestoreShown, RestoreValues
from app.sets.view import compared_json
from bus.catalogue.parameters import PARAMETERS


def restore_json(restore: Restore) -> RestoreShown:
    """As programs and the page see it. ``rows`` of a plan holds the rows that can still be chosen too."""
    offered = restore.offered if restore.state == "planned" else []
    chosen = [_row_json(restore, row, None) for row in restore.rows]
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
        "rows": chosen + [_row_json(restore, RowResult(write), left) for write, left in offered],
        "left_out": [_left_out_json(restore, left) for left in restore.left_out],
        "remaining": None if restore.remaining is None else [compared_json(row) for row in restore.remaining],
    }


def _row_json(restore: Restore, row: RowResult, left: LeftOut | None) -> RestoreRowShown:
    number = row.write.number
    values = _values(restore, number, row.write.present, row.write.wanted)
    words = meaning(number)
    return {
        **values,
        "selected": left is None,
        "reason": None if left is None else left.text,
        "reason_code": None if left is None else left.reason,
        "effect": EFFECTS.get(number),
        "warning": warning_of(number, row.write.wanted, running=restore.running) or None,
        "words": words,
        "meaning": words.format(new=values["wanted"], old=values["present"]),
        "outcome": row.outcome,
        "message": row.message,
        "read_back": None if PARAMETERS[number].secret else row.read_back,
    }


def _left_out_json(restore: Restore, left: LeftOut) -> LeftOutShown:
    present, wanted = restore.before.raw(left.number), restore.wanted.raw(left.number)
    return {
        **_values(restore, left.number, present, wanted),
        "reason": left.text,
        "reason_code": left.reason,
        "later": left.later,
        "differs": None if present is None or wanted is None else present != wanted,
    }


def _values(restore: Restore, number: int, present: int | None, wanted: int | None) -> RestoreValues:
    parameter = PARAMETERS[number]
    return {
        "number": number,
        "name": parameter.name,
        "present_raw": None if parameter.secret else present,
        "wanted_raw": None if parameter.secret else wanted,
        "present": _shown(restore.before, number, present),
        "wanted": _shown(restore.wanted, number, wanted),
    }


def _shown(rows: UnitRows, number: int, raw: int | None) -> str | None:
    parameter = PARAMETERS[number]
    if parameter.secret:
        return "secret"
    return None if raw is None else with_unit(parameter, raw, rows)
