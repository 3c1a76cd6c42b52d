"""A restore as it runs: row after row, each verified, and what is done is always known.

Nothing is written before a person has seen the plan. Stopped half way, by whatever, the rows say
exactly what was done; the same restore asked again finds the done rows equal and finishes the rest.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace

import structlog

from app.audit.log import EventLog
from app.commands.desk import Desk
from app.errors import Problem, StoreError
from app.sets.background import Background
from app.sets.model import UnitRows
from app.sets.plan import plan_restore
from app.sets.reading import ParameterReader
from app.sets.restore_record import UNDER_WAY, Restore, RowResult
from app.sets.restore_store import ENDED_MEANWHILE, RestoreStore
from app.web.access import Person
from bus.contract import WriteParameter
from bus.errors import unit_error_name

_log = structlog.get_logger(__name__)

_KEEP_FINISHED = 50
_UNDER_WAY_AT_END = "the server ended while it was under way"


class RestoreDesk:
    """Plans restores, runs them one at a time per unit, and remembers how they went, also on disk."""

    def __init__(self, reader: ParameterReader, desk: Desk, events: EventLog, store: RestoreStore) -> None:
        self._reader = reader
        self._desk = desk
        self._events = events
        self._store = store
        self._restores: dict[str, Restore] = {}
        self._background = Background()
        self.on_end: Callable[[Restore], Awaitable[None]] | None = None
        """Who wants to know that a restore is over."""

    async def find(self, restore_id: str) -> Restore | None:
        """A restore planned since the server started, or begun at any time."""
        return self._restores.get(restore_id) or await self._store.load(restore_id)

    async def of_unit(self, bus: str, unit: int) -> list[Restore]:
        """The last restores of a unit that were begun, newest first."""
        return [self._restores.get(begun.id, begun) for begun in await self._store.of_unit(bus, unit)]

    async def load(self) -> None:
        """Once at start: what was under way when the server ended is stopped, and says what was done."""
        for restore in await self._store.under_way():
            restore.state, restore.cause = "stopped", _UNDER_WAY_AT_END
            await self._store.end(restore)
            await self._record(restore.who, restore)

    async def plan(
        self,
        person: Person,
        bus: str,
        unit: int,
        wanted: UnitRows,
        *,
        running: bool | None,
        remote: bool | None = None,
        ticked: frozenset[int] = frozenset(),
    ) -> Restore:
        """Read the unit now and say what would be written; nothing is. ``running``, ``remote``: the Run
        input and REMOTE as last read, None where not known."""
        before = await self._reader.read_unit(person, bus, unit, urgent=True)
        plan = plan_restore(wanted, before, running=running, remote=remote, ticked=ticked)
        restore = Restore(
            id=secrets.token_hex(8),
            bus=bus,
            unit=unit,
            who=person.name,
            wanted=wanted,
            before=before,
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
        if any(other.state in UNDER_WAY and _same_unit(other, restore) for other in self._restores.values()):
            raise Problem(409, "busy", f"unit {restore.unit} is being restored by another; wait for its end")
        restore.state = "running"
        self._background.begin(self._run(person, restore), f"restore {restore.id}")

    async def close(self) -> None:
        """End what runs; the rows keep what was done."""
        await self._background.close()

    async def _run(self, person: Person, restore: Restore) -> None:
        try:
            await self._store.begin(restore)
            await self._write_rows(person, restore)
            await self._prove(person, restore)
        except Problem as problem:
            restore.state, restore.cause = "stopped", problem.detail
        except StoreError as error:
            restore.state, restore.cause = "stopped", str(error)
        except asyncio.CancelledError:
            restore.state, restore.cause = "stopped", "the server was shut down"
            raise
        except Exception:
            _log.exception("a restore failed", restore=restore.id)
            restore.state, restore.cause = "stopped", "an error in the server; its log says more"
        finally:
            await self._end(person, restore)

    async def _end(self, person: Person, restore: Restore) -> None:
        try:
            await self._store.end(restore)
            await self._record(person.name, restore)
            if self.on_end is not None:
                await self.on_end(restore)
        except StoreError as error:
            restore.cause = f"{restore.cause}; {error}" if restore.cause else str(error)

    async def _write_rows(self, person: Person, restore: Restore) -> None:
        for place, row in enumerate(restore.rows):
            if restore.cancelled:
                raise Problem(409, "cancelled", f"left off by {restore.who} after {restore.done} rows")
            await self._store.sending(restore, place)
            try:
                restore.rows[place] = await self._write_row(person, restore, row)
            except asyncio.CancelledError:
                restore.rows[place] = replace(row, outcome="unverified", message=ENDED_MEANWHILE)
                raise
            finally:
                await self._store.row(restore, place)
            if restore.rows[place].outcome == "unverified":
                raise Problem(504, "unverified", f"#{row.write.number}: {restore.rows[place].message}")

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
        restore.state = "different" if restore.remaining else "equal"

    async def _record(self, who: str, restore: Restore) -> None:
        verified = sum(row.outcome == "verified" for row in restore.rows)
        await self._events.record(
            kind="restore",
            who=who,
            bus=restore.bus,
            unit=restore.unit,
            what=f"parameters restored: {verified} of {len(restore.rows)} rows verified",
            outcome=restore.state,
            message="; ".join(part for part in (restore.cause, restore.account()) if part),
        )

    def _remember(self, restore: Restore) -> None:
        self._restores[restore.id] = restore
        ended = [key for key, known in self._restores.items() if known.state not in UNDER_WAY]
        for key in ended[:-_KEEP_FINISHED]:
            del self._restores[key]


def _same_unit(one: Restore, other: Restore) -> bool:
    return one is not other and (one.bus, one.unit) == (other.bus, other.unit)
