"""Sets and comparisons as JSON. #21 never leaves here."""

from __future__ import annotations

from app.sets.compare import Compared, with_unit
from app.sets.drift import DriftedParameter
from app.sets.model import ParameterSet, UnitRows
from app.sets.shown import (
    ComparedShown,
    DepartureShown,
    SetHead,
    SetParameterShown,
    SetShown,
    SetUnitShown,
    SummaryShown,
)
from app.sets.store import SetSummary
from app.web.message_shown import maybe_shown, message_shown
from app.web.shape import iso
from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message, in_english


def summary_json(summary: SetSummary) -> SummaryShown:
    """One line of the list."""
    return {
        **_head(summary),
        "units": list(summary.units),
    }


def set_json(stored: ParameterSet) -> SetShown:
    """A complete set; secrets masked."""
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
                "value": None if shown or row.raw is None else str(with_unit(parameter, row.raw, rows)),
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
        "left": str(row.old),
        "left_message": message_shown(row.old),
        "right": str(row.new),
        "right_message": message_shown(row.new),
        "left_raw": None if secret or row.left is None else row.left.raw,
        "right_raw": None if secret or row.right is None else row.right.raw,
        "meaning": in_english(row.meaning),
        "meaning_message": maybe_shown(row.meaning),
    }


def departure_json(departure: DriftedParameter) -> DepartureShown:
    """A row of a comparison with the golden set, and whose change it is."""
    change = departure.change
    changed = Message("changed_at_panel") if change is None else Message.of("changed_by", who=change["who"])
    return {
        **compared_json(departure.row),
        "changed_by": None if change is None else change["who"],
        "changed_at": None if change is None else iso(change["time"]),
        "changed": str(changed),
        "changed_message": message_shown(changed),
    }
