"""Restores of one unit: the writes, their order, their effect on the machine, their results. Pure.

The order makes no state on the way worse than the first or the last. Each row takes effect at once, so a unit
runs for a moment on a mixture of old and new values. Bounds are widened before the values that they bound,
and narrowed after them. Writes that slow a running unit come before those that make it faster: on the way it
is never faster than both before and afterwards.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal

from app.engineering.sets.model import ParameterDifference, UnitRows, differences
from app.errors import Problem
from app.line.commands.effects import OPERATING_VALUES, effect_message, warning_of
from bus.catalogue import parameters as numbers
from bus.catalogue.parameters import (
    CONTROL_MODE,
    FOLLOWER_MODE,
    PARAMETERS,
    check_writable_value,
    danger_of_writing,
)
from bus.contract import Outcome
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message, joined, listed, parameter_name, term

INVERSE_FOLLOWER = 2
"""The value of #8 for a unit that slows down as its ratio rises (manual, 4.0)."""
_MEANING = (numbers.DECIMALS, numbers.FOLLOWER_MODE)
_ENDS_TALK = (numbers.PASSWORD, numbers.PROTOCOL, numbers.BAUD_RATE, numbers.CONTROL_MODE)
"""The rows after which the unit may no longer respond; they come last."""
_BOUNDS = ((numbers.ANALOG_IN_LOW, numbers.ANALOG_IN_HIGH), (numbers.ANALOG_OUT_LOW, numbers.ANALOG_OUT_HIGH))
"""The pairs (low, high) that bound each other and nothing else."""


@dataclass(frozen=True, slots=True)
class Write:
    """A parameter to write, with its present and its wanted value."""

    number: int
    present: int
    wanted: int

    @property
    def up(self) -> bool:
        """Whether the value grows."""
        return self.wanted > self.present


class _Step(IntEnum):
    ALLOW_SETUP = 0
    MEANING = 1
    WIDEN = 2
    SLOWER = 3
    OTHERS = 4
    FASTER = 5
    NARROW = 6
    FORBID_SETUP = 7
    ENDS_TALK = 8


_STEPS: Mapping[int, tuple[_Step, _Step]] = {
    **dict.fromkeys((numbers.MAX_DISPLAY, numbers.MAX_RATIO), (_Step.WIDEN, _Step.NARROW)),
    numbers.MIN_RATIO: (_Step.NARROW, _Step.WIDEN),
    **dict.fromkeys(
        (
            *(numbers.MAX_RPM, numbers.BASE_RATIO, numbers.ENCODER_PPR, numbers.PRESET_SPEED),
            *(numbers.JUMP_UP, numbers.SPEED_SETPOINT, numbers.RATIO_SETPOINT),
        ),
        (_Step.FASTER, _Step.SLOWER),
    ),
    numbers.JUMP_DOWN: (_Step.SLOWER, _Step.FASTER),
}
"""The step of a value that grows, and of one that falls, by number.

The motor speed is the setpoint * #1 / #2 by the pulses of #5; in a follower that of the master * #4 * #37. #2
is one of the bounds. #9 to #11 replace or move the setpoint while their inputs are on.
"""


def in_order(writes: Iterable[Write], *, mode: int | None) -> tuple[Write, ...]:
    """Put writes in order. ``mode``: #8 of the unit now, None if it is not known."""
    ordered = sorted(writes, key=lambda write: _rank(write, mode))
    for low, high in _BOUNDS:
        _widen_first(ordered, low, high)
    return tuple(ordered)


def _rank(write: Write, mode: int | None) -> tuple[_Step, int]:
    number = write.number
    if number in _MEANING:
        return _Step.MEANING, _MEANING.index(number)
    if number in _ENDS_TALK:
        return _Step.ENDS_TALK, _ENDS_TALK.index(number)
    if number == numbers.SETUP_DURING_RUN:
        return (_Step.ALLOW_SETUP if write.wanted else _Step.FORBID_SETUP), number
    growing, falling = _STEPS.get(number, (_Step.OTHERS, _Step.OTHERS))
    is_inverse = number == numbers.RATIO_SETPOINT and mode == INVERSE_FOLLOWER
    return (growing if write.up != is_inverse else falling), number


def _widen_first(ordered: list[Write], low: int, high: int) -> None:
    """Exchange two writes if low would be above high between them."""
    at = {write.number: index for index, write in enumerate(ordered) if write.number in (low, high)}
    if len(at) < 2:
        return
    lower, upper = ordered[at[low]], ordered[at[high]]
    wanted_first = upper if lower.wanted > upper.present else lower
    first, second = sorted(at.values())
    ordered[first] = wanted_first
    ordered[second] = lower if wanted_first is upper else upper


@dataclass(frozen=True, slots=True)
class Selection:
    """The rows that a person selected, by number.

    ``include``: rows that are written only if named; ``exclude``: rows not to write; ``confirmed``: dangerous
    rows to write, each confirmed separately. Raises Problem 422 for a row that is both named and excluded.
    """

    include: frozenset[int] = frozenset()
    exclude: frozenset[int] = frozenset()
    confirmed: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        both = sorted(self.exclude & (self.include | self.confirmed))
        if both:
            raise Problem(422, "invalid", Message.of("row_included_and_excluded", number=both[0]))

    def choosing(self, include: frozenset[int], exclude: frozenset[int]) -> Selection:
        """Return another selection; confirmed rows stay confirmed unless they are now excluded."""
        return replace(self, include=include, exclude=exclude, confirmed=self.confirmed - exclude)


EVERYTHING_HARMLESS = Selection()
"""The selection of all rows except setpoints and dangerous rows."""

_REMOTE = 1
"""The value of #19 of a unit that takes writes (manual, 4.0)."""

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
"""The reason why a row is left out, for programs."""
CHOSEN: frozenset[Reason] = frozenset({"operating_value", "deselected"})
"""The reasons that a person can remove by choosing the row."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A row that differs or may differ and is not written; ``text`` is the reason for people. ``reason`` is
    None in a restore that a former version stored."""

    number: int
    reason: Reason | None
    text: Message

    @property
    def later(self) -> bool:
        """Whether the same restore writes the row once a person has set the unit to REMOTE at its keypad."""
        return self.reason == "not_in_remote"


@dataclass(frozen=True, slots=True)
class RestorePlan:
    """The rows that a restore writes, in order, the rows that it leaves out, and the number of equal rows."""

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
    """Plan the writes that make ``present`` equal ``wanted``.

    ``running``: the Run input of the unit; None (not known) counts as running. ``remote``: whether the status
    of the unit is REMOTE; if None (not known), #19 decides.
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
    """Raise Problem 409 ``dangerous`` or 422 ``invalid`` for a selected row that cannot be written.

    A unit that is not in REMOTE refuses every row; the plan states that instead.
    """
    for left in plan.left_out:
        if left.number not in selection.include or left.later:
            continue
        if left.reason == "dangerous":
            message = Message.of("row_needs_confirmation", number=left.number, why=left.text)
            raise Problem(409, "dangerous", message)
        raise Problem(422, "invalid", Message.of("row_not_writable", number=left.number, why=left.text))


def _why_not(number: int, wanted: UnitRows, present: UnitRows, *, running: bool) -> LeftOut | None:
    """Return the reason why a differing row cannot be written, even if selected."""
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


RestoreState = Literal["planned", "running", "proving", "equal", "different", "stopped"]
UNDER_WAY: frozenset[RestoreState] = frozenset({"running", "proving"})
_ACCOUNT: dict[str, tuple[Outcome | None, ...]] = {
    "rows_done": ("verified",),
    "rows_in_doubt": ("unverified", "acknowledged"),
    "rows_refused": ("refused", "invalid"),
    "rows_not_written": (None, "not_sent", "bus_closed"),
}


@dataclass(frozen=True, slots=True)
class RowResult:
    """A row of the plan and its outcome, once it was tried or given up."""

    write: Write
    outcome: Outcome | None = None
    message: Message | None = None
    read_back: int | None = None


@dataclass(slots=True)
class Restore:
    """A restore from its plan to its end.

    ``wanted``: the requested rows; ``before``: the unit's values; ``proven``: the values of the full read at
    the end. ``running``, ``remote``: the Run input and REMOTE at the time of the plan, None if not known.
    ``cause``, ``cause_code``: the reason why it stopped, for people and for programs.
    """

    id: str
    bus: str
    unit: int
    who: str
    wanted: UnitRows
    before: UnitRows
    plan: RestorePlan
    rows: list[RowResult]
    planned_at: UnixTime
    state: RestoreState = "planned"
    cause: Message | None = None
    cause_code: str | None = None
    proven: UnitRows | None = None
    selection: Selection = EVERYTHING_HARMLESS
    running: bool | None = None
    remote: bool | None = None
    cancelled_by: str = ""
    """The user who stopped the restore after its current row."""
    for_swap: bool = False
    """Whether the unit is a spare that replaces another."""

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """The rows that are not written, with the reasons."""
        return self.plan.left_out

    @property
    def offered(self) -> list[tuple[Write, LeftOut]]:
        """The rows that a person may still choose to write, with the reason why each is left out."""
        return [
            (Write(left.number, present, wanted), left)
            for left in self.left_out
            if left.reason in CHOSEN
            and (present := self.before.raw(left.number)) is not None
            and (wanted := self.wanted.raw(left.number)) is not None
        ]

    @property
    def remarks(self) -> list[Message]:
        """Remarks on the set and the unit, shown before anything is written."""
        return remarks(self.wanted, self.before, running=self.running, writes=self.plan.writes)

    @property
    def done(self) -> int:
        return sum(row.outcome is not None for row in self.rows)

    @property
    def remaining(self) -> list[ParameterDifference] | None:
        """The rows that still differ by the full read, except those that cannot be written at all."""
        if self.proven is None:
            return None
        never = {left.number for left in self.left_out if not left.later}
        return [row for row in differences(self.wanted, self.proven) if row.number not in never]

    def stop(self, code: str, cause: Message) -> None:
        """End the restore early; each row without an outcome becomes ``not_sent``."""
        self.state, self.cause_code, self.cause = "stopped", code, cause
        self.rows = [row if row.outcome else replace(row, outcome="not_sent") for row in self.rows]

    def account(self) -> Message | None:
        """List the rows that were verified, that are in doubt or refused, and that were not tried."""
        return joined(
            Message(code, {"rows": listed([parameter_name(number) for number in numbers])})
            for code, outcomes in _ACCOUNT.items()
            if (numbers := [row.write.number for row in self.rows if row.outcome in outcomes])
        )


RUNS = Message("restore_runs")
MAY_RUN = Message("restore_may_run")


def remarks(
    wanted: UnitRows, present: UnitRows, *, running: bool | None, writes: Iterable[Write]
) -> list[Message]:
    """Return warnings of a machine that runs, and of a set from another unit or type of section.

    ``running``: the Run input of the unit, None if it is not known.
    """
    found: list[Message] = []
    warnings = (warning_of(write.number, write.wanted, running=running) for write in writes)
    if running is not False and any(warnings):
        found.append(MAY_RUN if running is None else RUNS)
    if wanted.unit != present.unit:
        found.append(Message.of("restore_of_other_unit", unit=wanted.unit, present=present.unit))
    kinds = [rows.raw(FOLLOWER_MODE) for rows in (wanted, present)]
    if None not in kinds and (kinds[0] == 0) != (kinds[1] == 0):
        found.append(Message("restore_of_master" if kinds[0] == 0 else "restore_of_follower"))
    for rows, code in ((wanted, "restore_source_lacks"), (present, "restore_unit_lacks")):
        lacks = sum(not row.available for row in rows.rows.values())
        if lacks:
            found.append(Message(code, {"count": len(rows.rows) - lacks, "all": len(PARAMETERS)}))
    return found
