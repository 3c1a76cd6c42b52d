"""A restore as it runs: row after row, each verified, and what is done is always known.

Nothing is written before a person has seen the plan. Stopped half way, by whatever, the rows say
exactly what was done; the same restore asked again finds the done rows equal and finishes the rest.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from dataclasses import dataclass, field, replace
from typing import Literal

from app.audit.log import EventLog
from app.commands.desk import Desk
from app.errors import Problem
from app.sets.background import Background
from app.sets.compare import Compared, differences
from app.sets.model import UnitRows
from app.sets.plan import LeftOut, RestorePlan, Write, plan_restore
from app.sets.reading import ParameterReader
from app.web.access import Person
from bus.contract import Outcome, WriteParameter
from bus.errors import unit_error_name

State = Literal["planned", "running", "proving", "equal", "different", "stopped"]
_ENDS: frozenset[State] = frozenset({"equal", "different", "stopped"})
_KEEP_FINISHED = 50


@dataclass(frozen=True, slots=True)
class RowResult:
    """One row of the plan and, once tried, its fate."""

    write: Write
    outcome: Outcome | None = None
    message: str = ""
    read_back: int | None = None


@dataclass(slots=True)
class Restore:
    """One restore of one unit. ``wanted`` the rows asked for, ``remaining`` what a full read afterwards
    still finds different (None until that read)."""

    id: str
    bus: str
    unit: int
    who: str
    wanted: UnitRows
    plan: RestorePlan
    rows: list[RowResult]
    planned_at: float
    state: State = "planned"
    cause: str = ""
    remaining: list[Compared] | None = None
    proven: UnitRows | None = None
    _cancelled: bool = field(default=False, repr=False)

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Rows named beforehand as not written."""
        return self.plan.left_out

    @property
    def done(self) -> int:
        """How many rows have their fate."""
        return sum(row.outcome is not None for row in self.rows)

    @property
    def ended(self) -> bool:
        """Whether nothing more will happen."""
        return self.state in _ENDS

    def cancel(self) -> None:
        """Leave off after the row in hand."""
        self._cancelled = True

    @property
    def cancelled(self) -> bool:
        """Whether a person asked to leave off."""
        return self._cancelled


class RestoreDesk:
    """Plans restores, runs them one at a time per unit, and remembers how they went."""

    def __init__(self, reader: ParameterReader, desk: Desk, events: EventLog) -> None:
        self._reader = reader
        self._desk = desk
        self._events = events
        self._restores: dict[str, Restore] = {}
        self._background = Background()

    def get(self, restore_id: str) -> Restore | None:
        """A restore planned or run since the server started."""
        return self._restores.get(restore_id)

    def newest(self, bus: str, unit: int) -> Restore | None:
        """The newest restore of a unit since the server started."""
        of_unit = (known for known in self._restores.values() if (known.bus, known.unit) == (bus, unit))
        return max(of_unit, key=lambda known: known.planned_at, default=None)

    async def plan(
        self,
        person: Person,
        bus: str,
        unit: int,
        wanted: UnitRows,
        *,
        running: bool | None,
        ticked: frozenset[int] = frozenset(),
    ) -> Restore:
        """Read the unit now and say what would be written; nothing is."""
        present = await self._reader.read_unit(person, bus, unit, urgent=True)
        plan = plan_restore(wanted, present, running=running, ticked=ticked)
        restore = Restore(
            id=secrets.token_hex(8),
            bus=bus,
            unit=unit,
            who=person.name,
            wanted=wanted,
            plan=plan,
            rows=[RowResult(write) for write in plan.writes],
            planned_at=time.time(),
        )
        self._remember(restore)
        return restore

    def start(self, person: Person, restore: Restore) -> None:
        """Begin writing. Raises Problem 409 when it has begun already or its unit is being restored."""
        if restore.state != "planned":
            raise Problem(409, "already_started", f"this restore has begun: it is {restore.state}")
        if any(
            other.state in ("running", "proving") and _same_unit(other, restore)
            for other in self._restores.values()
        ):
            raise Problem(409, "busy", f"unit {restore.unit} is being restored by another; wait for its end")
        restore.state = "running"
        self._background.begin(self._run(person, restore), f"restore {restore.id}")

    async def close(self) -> None:
        """End what runs; the rows keep what was done."""
        await self._background.close()

    async def _run(self, person: Person, restore: Restore) -> None:
        try:
            await self._write_rows(person, restore)
            await self._prove(person, restore)
        except Problem as problem:
            restore.state, restore.cause = "stopped", problem.detail
        except asyncio.CancelledError:
            restore.state, restore.cause = "stopped", "the server was shut down"
            raise
        finally:
            await self._record(person, restore)

    async def _write_rows(self, person: Person, restore: Restore) -> None:
        for index, row in enumerate(restore.rows):
            if restore.cancelled:
                raise Problem(409, "cancelled", f"left off by {restore.who} after {restore.done} rows")
            restore.rows[index] = await self._write_row(person, restore, row)
            if restore.rows[index].outcome == "unverified":
                raise Problem(504, "unverified", f"#{row.write.number}: {restore.rows[index].message}")

    async def _write_row(self, person: Person, restore: Restore, row: RowResult) -> RowResult:
        action = WriteParameter(unit=restore.unit, number=row.write.number, raw=row.write.wanted)
        result = await self._desk.ask(person, restore.bus, action, confirm=True, origin="restore")
        message = result.message
        if result.outcome == "refused" and result.unit_error is not None:
            message = f"refused: {unit_error_name(result.unit_error)}"
        if result.outcome in ("not_sent", "bus_closed"):
            raise Problem(503, result.outcome, message or "nothing more was sent")
        return replace(row, outcome=result.outcome, message=message, read_back=result.read_back)

    async def _prove(self, person: Person, restore: Restore) -> None:
        """The proof is a full read afterwards."""
        restore.state = "proving"
        restore.proven = await self._reader.read_unit(person, restore.bus, restore.unit, urgent=True)
        named = {left.number for left in restore.left_out}
        rows = differences(restore.wanted, restore.proven)
        restore.remaining = [row for row in rows if row.number not in named]
        restore.state = "different" if restore.remaining else "equal"

    async def _record(self, person: Person, restore: Restore) -> None:
        verified = sum(row.outcome == "verified" for row in restore.rows)
        await self._events.record(
            kind="restore",
            who=person.name,
            bus=restore.bus,
            unit=restore.unit,
            what=f"parameters restored: {verified} of {len(restore.rows)} rows verified",
            outcome=restore.state,
            message=restore.cause,
        )

    def _remember(self, restore: Restore) -> None:
        self._restores[restore.id] = restore
        ended = [key for key, known in self._restores.items() if known.ended or known.state == "planned"]
        for key in ended[:-_KEEP_FINISHED]:
            del self._restores[key]


def _same_unit(one: Restore, other: Restore) -> bool:
    return one is not other and (one.bus, one.unit) == (other.bus, other.unit)
