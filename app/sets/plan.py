"""What a restore will write, in which order, and what it leaves out: known before anything is sent."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from app.sets.model import UnitRows
from bus.catalogue.parameters import PARAMETERS, check_writable_value, danger_of_writing
from bus.errors import CallerError

_FIRST = (1, 2, 3, 8)
"""Full scale, display and mode give the other rows their meaning and their bounds."""
_LAST = (21, 27, 18, 19)
"""What may end the conversation comes when everything else is done."""
_ALLOW_SETUP_DURING_RUN = 16
_MODE, _CONTROL, _REMOTE = 8, 19, 1
NOT_IN_REMOTE = (
    "the unit is not in REMOTE and refuses every write; set #19 to 1 at its keypad, then plan again"
)
_BOUNDS = ((38, 31), (22, 23), (29, 30))
"""(low, high) pairs: the end that widens the window is written first."""
_BOUNDED_LATE = (4, 37, 9, 10, 11, 12, 20)
"""Ratios after #38…#31, presets and setpoints after #2: a maximum before what it bounds."""


@dataclass(frozen=True, slots=True)
class Write:
    """One row to write."""

    number: int
    present: int
    wanted: int


@dataclass(frozen=True, slots=True)
class LeftOut:
    """One row that differs or may differ and is not written; ``reason`` is a sentence.

    ``later``: once somebody has set the unit to REMOTE at its panel, the same restore writes it.
    """

    number: int
    reason: str
    later: bool = False


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
    ticked: frozenset[int] = frozenset(),
) -> RestorePlan:
    """``running``: the Run input of the unit (None: not known, taken as running).

    ``remote``: whether its status says REMOTE (None: not known; then its #19 alone says it).
    ``ticked``: dangerous parameters that a person has confirmed one by one.
    """
    writes: list[Write] = []
    left_out: list[LeftOut] = []
    equal = 0
    refuses = remote is False or (remote is None and present.raw(_CONTROL) not in (None, _REMOTE))
    for number in PARAMETERS:
        reason = _why_not(number, wanted, present, running=running is not False, ticked=ticked)
        new, old = wanted.raw(number), present.raw(number)
        if new is not None and new == old:
            equal += 1
        elif reason:
            left_out.append(LeftOut(number, reason))
        elif refuses:
            left_out.append(LeftOut(number, NOT_IN_REMOTE, later=True))
        elif new is not None and old is not None:
            writes.append(Write(number, old, new))
    return RestorePlan(tuple(_in_order(writes)), tuple(left_out), equal)


def remarks(wanted: UnitRows, present: UnitRows) -> list[str]:
    """What a person ought to know of the set before any row of it: whose it is, and of what kind."""
    found: list[str] = []
    if wanted.unit != present.unit:
        found.append(f"the set is of unit {wanted.unit}, this is unit {present.unit}: read every row")
    kinds = [rows.raw(_MODE) for rows in (wanted, present)]
    if None not in kinds and (kinds[0] == 0) != (kinds[1] == 0):
        found.append(
            "the set is of a master, this unit follows by ratio (#8): another type of section"
            if kinds[0] == 0
            else "the set is of a follower by ratio, this unit is a master (#8): another type of section"
        )
    for rows, text in ((wanted, "the unit of the set"), (present, "this unit")):
        lacks = sum(not row.available for row in rows.rows.values())
        if lacks:
            found.append(f"{text} has {len(rows.rows) - lacks} of {len(PARAMETERS)} parameters only")
    return found


def _why_not(
    number: int, wanted: UnitRows, present: UnitRows, *, running: bool, ticked: frozenset[int]
) -> str:
    """Why a row that is not equal is left out, whatever the unit's mode; empty when it may be written."""
    parameter = PARAMETERS[number]
    there, asked = present.rows.get(number), wanted.rows.get(number)
    if parameter.never_writable:
        return "the address is set at the keypad only; the link cannot write it"
    if asked is None or asked.raw is None:
        return _not_held(number, wanted)
    if there is not None and not there.available:
        return "this unit does not have it"
    if there is None or there.raw is None:
        return "it could not be read from the unit"
    if number == _MODE and running:
        return "no change while Run is on"
    try:
        check_writable_value(parameter, asked.raw)
    except CallerError as error:
        return str(error)
    return "" if number in ticked else danger_of_writing(parameter, asked.raw)


def _not_held(number: int, wanted: UnitRows) -> str:
    row = wanted.rows.get(number)
    if row is not None and not row.available:
        return "the unit of the set did not have it"
    return "secret, not held in the set" if PARAMETERS[number].secret else "the set does not hold it"


def _in_order(writes: Iterable[Write]) -> list[Write]:
    ordered = sorted(writes, key=_rank)
    for low, high in _BOUNDS:
        _widen_first(ordered, low, high)
    return ordered


def _rank(write: Write) -> tuple[int, int]:
    number = write.number
    if number == _ALLOW_SETUP_DURING_RUN:
        return (0, 0) if write.wanted else (4, 0)
    if number in _FIRST:
        return (1, _FIRST.index(number))
    if number in _LAST:
        return (5, _LAST.index(number))
    return (3, _BOUNDED_LATE.index(number)) if number in _BOUNDED_LATE else (2, number)


def _widen_first(ordered: list[Write], low: int, high: int) -> None:
    """Exchange the two where the order at hand would ask for low > high on the way."""
    at = {write.number: index for index, write in enumerate(ordered) if write.number in (low, high)}
    if len(at) < 2:
        return
    lower, upper = ordered[at[low]], ordered[at[high]]
    wanted_first = upper if lower.wanted > upper.present else lower
    first, second = sorted(at.values())
    ordered[first] = wanted_first
    ordered[second] = lower if wanted_first is upper else upper
