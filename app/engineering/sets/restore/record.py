"""One restore of one unit: its risks, what each row became, and what a full read found. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

from app.engineering.sets.comparison.compare import ParameterDifference, differences
from app.engineering.sets.model import UnitRows
from app.engineering.sets.restore.effects import warning_of
from app.engineering.sets.restore.order import Write
from app.engineering.sets.restore.plan import CHOSEN, EVERYTHING_HARMLESS, LeftOut, RestorePlan, Selection
from bus.catalogue.numbers import FOLLOWER_MODE
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Outcome
from bus.instants import UnixTime
from bus.messages import Message, joined, listed, parameter_name

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
    """One row of the plan and, once tried or given up, its outcome."""

    write: Write
    outcome: Outcome | None = None
    message: Message | None = None
    read_back: int | None = None


@dataclass(slots=True)
class Restore:
    """``wanted``: the requested rows; ``before``: the unit's values; ``proven``: those of a full read
    afterwards (None until that read). ``running``, ``remote``: the Run input and REMOTE when it was planned,
    None where not known. ``cause``, ``cause_code``: why it stopped, for people and programs.
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
    """The user who stopped it after the current row."""
    for_swap: bool = False
    """Whether it makes a spare of the unit."""

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Rows named beforehand as not written."""
        return self.plan.left_out

    @property
    def offered(self) -> list[tuple[Write, LeftOut]]:
        """Rows that a person may still choose to write, with the reason why they are left out."""
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
        """What the full read still finds different, without what can never be written here."""
        if self.proven is None:
            return None
        never = {left.number for left in self.left_out if not left.later}
        return [row for row in differences(self.wanted, self.proven) if row.number not in never]

    def stop(self, code: str, cause: Message) -> None:
        """End it before its time: every row without an outcome was not sent."""
        self.state, self.cause_code, self.cause = "stopped", code, cause
        self.rows = [row if row.outcome else replace(row, outcome="not_sent") for row in self.rows]

    def account(self) -> Message | None:
        """Which rows were written and verified, which are unverified or refused, which were not tried."""
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
    """Whether the machine runs, whose set it is, and of what kind. ``running``: the Run input of the unit,
    None where not known."""
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
