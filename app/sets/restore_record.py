"""One restore of one unit, as far as it has come: what each row became, and what a full read found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from app.sets.compare import Compared, differences
from app.sets.model import UnitRows
from app.sets.plan import LeftOut, RestorePlan, Write, remarks
from bus.contract import Outcome

State = Literal["planned", "running", "proving", "equal", "different", "stopped"]
ENDS: frozenset[State] = frozenset({"equal", "different", "stopped"})
UNDER_WAY: frozenset[State] = frozenset({"running", "proving"})


@dataclass(frozen=True, slots=True)
class RowResult:
    """One row of the plan and, once tried, its fate."""

    write: Write
    outcome: Outcome | None = None
    message: str = ""
    read_back: int | None = None


@dataclass(slots=True)
class Restore:
    """``wanted`` the rows asked for, ``before`` what the unit was, ``proven`` what a full read found
    afterwards (None until that read)."""

    id: str
    bus: str
    unit: int
    who: str
    wanted: UnitRows
    before: UnitRows
    plan: RestorePlan
    rows: list[RowResult]
    planned_at: float
    state: State = "planned"
    cause: str = ""
    proven: UnitRows | None = None
    cancelled: bool = field(default=False, repr=False)
    """Whether a person asked to leave off."""

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Rows named beforehand as not written."""
        return self.plan.left_out

    @property
    def remarks(self) -> list[str]:
        """What is to be known of the set before it is written."""
        return remarks(self.wanted, self.before)

    @property
    def done(self) -> int:
        """How many rows have their fate."""
        return sum(row.outcome is not None for row in self.rows)

    @property
    def ended(self) -> bool:
        """Whether nothing more will happen."""
        return self.state in ENDS

    @property
    def remaining(self) -> list[Compared] | None:
        """What the full read still finds different, without what can never be written here."""
        if self.proven is None:
            return None
        never = {left.number for left in self.left_out if not left.later}
        return [row for row in differences(self.wanted, self.proven) if row.number not in never]

    def cancel(self) -> None:
        """Leave off after the row in hand."""
        self.cancelled = True

    def account(self) -> str:
        """Which rows were written and proven, which are in doubt or refused, which were not tried."""
        fates = {
            "done": [row for row in self.rows if row.outcome == "verified"],
            "in doubt": [row for row in self.rows if row.outcome in ("unverified", "acknowledged")],
            "refused": [row for row in self.rows if row.outcome == "refused"],
            "not written": [row for row in self.rows if row.outcome in (None, "not_sent", "bus_closed")],
        }
        return "; ".join(f"{fate}: {_numbers(rows)}" for fate, rows in fates.items() if rows)


def _numbers(rows: list[RowResult]) -> str:
    return ", ".join(f"#{row.write.number}" for row in rows)
