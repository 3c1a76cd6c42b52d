"""Set with set, set with live unit, unit with unit: row by row, with what a difference means."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.sets.effects import OPERATING_VALUES
from app.sets.model import ParameterRow, UnitRows
from bus.catalogue.numbers import DECIMALS, FOLLOWER_MODE
from bus.catalogue.parameters import PARAMETERS, Parameter
from bus.catalogue.values import is_follower, parameter_text, parameter_unit

Comparison = Literal["equal", "differs", "unavailable", "unknown"]

_MEANINGS: dict[int, str] = {
    1: "full scale is {new} instead of {old}",
    2: "shows {new} at full scale instead of {old}",
    3: "shows {new} decimals instead of {old}",
    4: "base ratio {new} instead of {old}",
    5: "its encoder gives {new} instead of {old}",
    6: "accelerates in {new} instead of {old}",
    7: "decelerates in {new} instead of {old}",
    8: "runs as {new} instead of {old}",
    12: "is at speed within {new} instead of {old}",
    17: "has the address {new} instead of {old}",
    18: "talks at {new} instead of {old}",
    31: "follows at {new} at most instead of {old}",
    38: "follows at {new} at least instead of {old}",
}
_ANY_MEANING = "{new} instead of {old}"
_SECRET_MEANING = "it differs; the secret value is not shown"


@dataclass(frozen=True, slots=True)
class Compared:
    """One row of a comparison. ``meaning`` is a template for ``old`` (left) and ``new`` (right) text."""

    number: int
    left: ParameterRow | None
    right: ParameterRow | None
    kind: Comparison
    old: str
    new: str
    meaning: str

    @property
    def sentence(self) -> str:
        """What the difference means, in English; empty for rows that do not differ."""
        return self.meaning.format(new=self.new, old=self.old)


def compare(left: UnitRows, right: UnitRows, tolerance: int = 0) -> list[Compared]:
    """All 40 rows; ``left`` is the reference. ``tolerance``: raw counts that still pass as equal."""
    return [_compare_row(parameter, left, right, tolerance) for parameter in PARAMETERS.values()]


def differences(left: UnitRows, right: UnitRows, tolerance: int = 0) -> list[Compared]:
    """Only the rows known to differ; one that only one of the two has is a difference too."""
    return [row for row in compare(left, right, tolerance) if row.kind in ("differs", "unavailable")]


def drift(golden: UnitRows, live: UnitRows) -> list[Compared]:
    """Rows in which a live unit departs from its golden set; setpoints do not count."""
    return [row for row in differences(golden, live) if row.number not in OPERATING_VALUES]


def _compare_row(parameter: Parameter, left: UnitRows, right: UnitRows, tolerance: int) -> Compared:
    old, new = left.rows.get(parameter.number), right.rows.get(parameter.number)
    kind = _kind(old, new, tolerance)
    return Compared(
        number=parameter.number,
        left=old,
        right=new,
        kind=kind,
        old=row_text(parameter, left),
        new=row_text(parameter, right),
        meaning=_words(parameter.number, kind),
    )


def _words(number: int, kind: Comparison) -> str:
    if kind == "differs":
        return meaning(number)
    return _ANY_MEANING if kind == "unavailable" else ""


def meaning(number: int) -> str:
    """What it means that a parameter differs: a template for the texts ``old`` and ``new``."""
    if PARAMETERS[number].secret:
        return _SECRET_MEANING
    return _MEANINGS.get(number, _ANY_MEANING)


def _kind(left: ParameterRow | None, right: ParameterRow | None, tolerance: int) -> Comparison:
    if left is None or right is None:
        return "unknown"
    if not left.available and not right.available:
        return "equal"
    if left.raw is not None and right.raw is not None:
        return "equal" if abs(left.raw - right.raw) <= tolerance else "differs"
    return "unknown" if left.available and right.available else "unavailable"


def row_text(parameter: Parameter, rows: UnitRows) -> str:
    """A row as shown to people: in its unit, a secret masked, a missing one said."""
    row = rows.rows.get(parameter.number)
    if row is not None and not row.available:
        return "not in this unit"
    if parameter.secret:
        return "secret"
    if row is None or row.raw is None:
        return "not known"
    return with_unit(parameter, row.raw, rows)


def with_unit(parameter: Parameter, raw: int, rows: UnitRows) -> str:
    """``50`` of #6 → ``5.0 s``, by the decimals (#3) and the mode (#8) that ``rows`` hold."""
    if raw in parameter.choices:
        return parameter.choices[raw]
    follower = is_follower(rows.raw(FOLLOWER_MODE))
    text = parameter_text(parameter, raw, rows.raw(DECIMALS), follower=follower)
    return f"{text} {parameter_unit(parameter)}".strip()
