"""Plans a restore: which rows it writes, in which order, and what it leaves out. Pure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from app.engineering.sets.model import UnitRows
from app.engineering.sets.restore.effects import OPERATING_VALUES, effect_message
from app.engineering.sets.restore.order import Write, in_order
from app.errors import Problem
from bus.catalogue.numbers import CONTROL_MODE, FOLLOWER_MODE
from bus.catalogue.parameter import check_writable_value, danger_of_writing
from bus.catalogue.parameters import PARAMETERS
from bus.errors import CallerError
from bus.messages import Message, term


@dataclass(frozen=True, slots=True)
class Selection:
    """The selected rows, by number. ``include``: rows that are left out unless named; ``exclude``:
    rows not to write; ``confirmed``: dangerous rows to write, each confirmed separately.

    Raises Problem 422 for a row that is both named and excluded.
    """

    include: frozenset[int] = frozenset()
    exclude: frozenset[int] = frozenset()
    confirmed: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        both = sorted(self.exclude & (self.include | self.confirmed))
        if both:
            raise Problem(422, "invalid", Message.of("row_included_and_excluded", number=both[0]))

    def choosing(self, include: frozenset[int], exclude: frozenset[int]) -> Selection:
        """Another choice of rows; what was confirmed stays so unless it is excluded now."""
        return replace(self, include=include, exclude=exclude, confirmed=self.confirmed - exclude)


EVERYTHING_HARMLESS = Selection()
"""The rows written without a selection: all but setpoints and dangerous ones."""


_REMOTE = 1
"""#19 of a unit that takes writes (manual, 4.0)."""

Reason = Literal[
    "address",
    "secret",
    "not_in_set",
    "not_in_unit",
    "not_read",
    "running",
    "illegal_value",
    "dangerous",
    "not_in_remote",
    "operating_value",
    "deselected",
]
"""Why a row is left out, for programs."""
CHOSEN: frozenset[Reason] = frozenset({"operating_value", "deselected"})
"""Rows that would be written had a person chosen so."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """One row that differs or may differ and is not written; ``text`` is the reason. ``reason`` None: it was
    left out by a version that did not store the reason."""

    number: int
    reason: Reason | None
    text: Message

    @property
    def later(self) -> bool:
        """Whether the same restore writes it once a person has set the unit to REMOTE at its panel."""
        return self.reason == "not_in_remote"


@dataclass(frozen=True, slots=True)
class RestorePlan:
    """``writes`` in order, ``left_out`` with reasons, ``equal`` rows that need nothing."""

    writes: tuple[Write, ...]
    left_out: tuple[LeftOut, ...]
    equal: int


def plan_restore(
    wanted: UnitRows,
    present: UnitRows,
    *,
    running: bool | None,
    remote: bool | None = None,
    selection: Selection = EVERYTHING_HARMLESS,
) -> RestorePlan:
    """``running``: the Run input of the unit (None: not known, taken as running).

    ``remote``: whether its status is REMOTE (None: not known; then its #19 alone decides).
    """
    writes: list[Write] = []
    left_out: list[LeftOut] = []
    equal = 0
    refuses = remote is False or (remote is None and present.raw(CONTROL_MODE) not in (None, _REMOTE))
    for number in PARAMETERS:
        new, old = wanted.raw(number), present.raw(number)
        if new is not None and new == old:
            equal += 1
            continue
        why = _why_not(number, wanted, present, running=running is not False)
        why = why or _why_not_chosen(number, new or 0, selection)
        if why is None and refuses:
            why = LeftOut(number, "not_in_remote", Message("row_not_in_remote"))
        if why is not None:
            left_out.append(why)
        elif new is not None and old is not None:
            writes.append(Write(number, old, new))
    return RestorePlan(in_order(writes, mode=present.raw(FOLLOWER_MODE)), tuple(left_out), equal)


def refuse_unwritable(plan: RestorePlan, selection: Selection) -> None:
    """Raises Problem 409 ``dangerous`` or 422 ``invalid`` for a row that was selected and cannot be
    written. A unit that is not in REMOTE refuses every row, and the plan states it."""
    for left in plan.left_out:
        if left.number not in selection.include or left.later:
            continue
        if left.reason == "dangerous":
            message = Message.of("row_needs_confirmation", number=left.number, why=left.text)
            raise Problem(409, "dangerous", message)
        raise Problem(422, "invalid", Message.of("row_not_writable", number=left.number, why=left.text))


def _why_not(number: int, wanted: UnitRows, present: UnitRows, *, running: bool) -> LeftOut | None:
    """Why a row that differs cannot be written, even if selected."""
    parameter = PARAMETERS[number]
    there, target = present.rows.get(number), wanted.rows.get(number)
    if parameter.never_writable:
        return LeftOut(number, "address", Message("row_address"))
    if target is None or target.raw is None:
        return _not_held(number, wanted)
    if there is not None and not there.available:
        return LeftOut(number, "not_in_unit", Message("row_not_in_unit"))
    if there is None or there.raw is None:
        return LeftOut(number, "not_read", Message("row_not_read"))
    if number == FOLLOWER_MODE and running:
        return LeftOut(number, "running", Message("row_running"))
    try:
        check_writable_value(parameter, target.raw)
    except CallerError as error:
        return LeftOut(number, "illegal_value", error.message)
    return None


def _why_not_chosen(number: int, raw: int, selection: Selection) -> LeftOut | None:
    danger = danger_of_writing(PARAMETERS[number], raw)
    if number in selection.exclude:
        return LeftOut(number, "deselected", Message("row_deselected"))
    if danger and number not in selection.confirmed:
        return LeftOut(number, "dangerous", term(danger))
    if number in OPERATING_VALUES - selection.include:
        return LeftOut(number, "operating_value", effect_message("setpoint"))
    return None


def _not_held(number: int, wanted: UnitRows) -> LeftOut:
    row = wanted.rows.get(number)
    if row is not None and not row.available:
        return LeftOut(number, "not_in_set", Message("row_lacked_by_source"))
    if PARAMETERS[number].secret:
        return LeftOut(number, "secret", Message("row_secret"))
    return LeftOut(number, "not_in_set", Message("row_not_in_set"))
