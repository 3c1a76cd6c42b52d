"""Sets, comparisons and restores as JSON. #21 never leaves here."""

from __future__ import annotations

from app.sets.compare import Compared, meaning, with_unit
from app.sets.drift import Departure
from app.sets.model import ParameterSet, UnitRows
from app.sets.restore_record import Restore, RowResult
from app.sets.shown import (
    ComparedShown,
    DepartureShown,
    RestoreRowShown,
    RestoreShown,
    SetHead,
    SetParameterShown,
    SetShown,
    SetUnitShown,
    SummaryShown,
)
from app.sets.store import SetSummary
from app.web.shape import iso
from bus.catalogue.parameters import PARAMETERS


def summary_json(summary: SetSummary) -> SummaryShown:
    """One line of the list."""
    return {
        **_head(summary),
        "units": list(summary.units),
    }


def set_json(stored: ParameterSet) -> SetShown:
    """A whole set; secrets masked."""
    return {
        **_head(stored),
        "units": [_unit_json(rows) for rows in stored.units],
    }


def _head(of: SetSummary | ParameterSet) -> SetHead:
    return {
        "id": of.id,
        "bus": of.bus,
        "name": of.name,
        "comment": of.comment,
        "taken_at": iso(of.taken_at),
        "who": of.who,
        "origin": of.origin,
        "golden_for": sorted(of.golden_for),
    }


def _unit_json(rows: UnitRows) -> SetUnitShown:
    parameters: list[SetParameterShown] = []
    for number, row in sorted(rows.rows.items()):
        parameter = PARAMETERS[number]
        shown = parameter.secret or row.raw is None
        parameters.append(
            {
                "number": number,
                "name": parameter.name,
                "raw": None if parameter.secret else row.raw,
                "value": None if shown or row.raw is None else with_unit(parameter, row.raw, rows),
                "available": row.available,
                "read_at": None if row.read_at is None else iso(row.read_at),
                "frame": None if parameter.secret else row.frame.hex(" "),
            }
        )
    return {"id": rows.unit, "name": rows.name, "parameters": parameters}


def compared_json(row: Compared) -> ComparedShown:
    """One row of a comparison, as shown to people and raw."""
    secret = PARAMETERS[row.number].secret
    return {
        "number": row.number,
        "name": PARAMETERS[row.number].name,
        "kind": row.kind,
        "left": row.old,
        "right": row.new,
        "left_raw": None if secret or row.left is None else row.left.raw,
        "right_raw": None if secret or row.right is None else row.right.raw,
        "meaning": row.sentence,
    }


def restore_json(restore: Restore) -> RestoreShown:
    """A restore: its plan, how far it is, and what a full read found afterwards."""
    return {
        "id": restore.id,
        "bus": restore.bus,
        "unit": restore.unit,
        "who": restore.who,
        "state": restore.state,
        "cause": restore.cause,
        "done": restore.done,
        "equal": restore.plan.equal,
        "remarks": restore.remarks,
        "rows": [_row_json(restore, row) for row in restore.rows],
        "left_out": [
            {
                "number": left.number,
                "name": PARAMETERS[left.number].name,
                "reason": left.reason,
                "later": left.later,
            }
            for left in restore.left_out
        ],
        "remaining": None if restore.remaining is None else [compared_json(row) for row in restore.remaining],
    }


def departure_json(departure: Departure) -> DepartureShown:
    """A row of a comparison with the golden set, and whose change it is."""
    change = departure.change
    return {
        **compared_json(departure.row),
        "changed_by": None if change is None else change["who"],
        "changed_at": None if change is None else iso(change["time"]),
        "changed": "at the panel" if change is None else f"by {change['who']}",
    }


def _row_json(restore: Restore, row: RowResult) -> RestoreRowShown:
    parameter = PARAMETERS[row.write.number]
    present = _shown(restore.before, row.write.number, row.write.present)
    wanted = _shown(restore.wanted, row.write.number, row.write.wanted)
    words = meaning(parameter.number)
    return {
        "number": parameter.number,
        "name": parameter.name,
        "present_raw": None if parameter.secret else row.write.present,
        "wanted_raw": None if parameter.secret else row.write.wanted,
        "present": present,
        "wanted": wanted,
        "words": words,
        "meaning": words.format(new=wanted, old=present),
        "outcome": row.outcome,
        "message": row.message,
        "read_back": None if parameter.secret else row.read_back,
    }


def _shown(rows: UnitRows, number: int, raw: int) -> str:
    parameter = PARAMETERS[number]
    return "secret" if parameter.secret else with_unit(parameter, raw, rows)
