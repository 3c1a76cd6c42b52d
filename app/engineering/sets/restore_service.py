"""The service of restores: plan, review, start, and store the outcome of each row.

Nothing is written before a person has seen the plan. However a restore is stopped, its rows state their
outcome; the same restore again finds the finished rows equal and writes the rest.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import replace

import msgspec
import structlog

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.core.database.database import Tables, reading
from app.core.lifespan import Background
from app.core.web.access import Person
from app.engineering.sets.model import UnitRows
from app.engineering.sets.restore_plan import (
    EVERYTHING_HARMLESS,
    UNDER_WAY,
    Restore,
    RestorePlan,
    RowResult,
    Selection,
    Write,
    plan_restore,
    refuse_unwritable,
)
from app.engineering.sets.saving import ParameterReader
from app.errors import Problem, StoreError
from app.line.commands.catalogue import WRITE_PARAMETER
from app.line.commands.effects import warning_of
from app.line.commands.service import CommandService
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from bus.catalogue.parameters import PARAMETERS
from bus.contract import WriteParameter
from bus.errors import unit_error
from bus.instants import unix_now
from bus.messages import Message, joined, term

PLAN = Act("plan_restore", WRITE_PARAMETER.role, "restore", "event_restored")
START = Act("start_restore", WRITE_PARAMETER.role, "restore", "event_restored")
CANCEL = Act("cancel_restore", WRITE_PARAMETER.role, "restore", "event_restored")
"""A restore writes parameters and needs the role for that; its end is recorded as one event."""
_NOT_KEPT = -1
"""The stored stand-in for a secret (#21), which only parameter sets hold: no raw value is negative."""
_MAX_OF_UNIT = 20
"""The earlier restores that the page of a unit lists."""
_MAX_ENDED = 50
"""The plans and ended restores that are kept in memory."""
_SAVE = upsert("restore", ("id",), ("bus", "unit", "planned_at", "state", "content"))
_DECODER = msgspec.json.Decoder(Restore)


class RestoreStore(Tables):
    """The table of restores, stored without secrets. A plan that was not begun is not stored."""

    async def save(self, restore: Restore) -> None:
        """Store the present state of a restore instead of the earlier one."""
        content = msgspec.json.encode(_without_secrets(restore)).decode()
        row = (restore.id, restore.bus, restore.unit, restore.planned_at, restore.state, content)
        await self.database.write(lambda connection: connection.execute(_SAVE, row))

    @reading
    def load(self, connection: StoreConnection, restore_id: str) -> Restore | None:
        """Return a restore that was begun, None if there is no such."""
        return next(_select(connection, "id = ?", restore_id), None)

    @reading
    def under_way(self, connection: StoreConnection) -> list[Restore]:
        """Return the restores that were under way when the server ended."""
        marks = ", ".join("?" * len(UNDER_WAY))
        return list(_select(connection, f"state IN ({marks})", *UNDER_WAY))

    @reading
    def of_unit(self, connection: StoreConnection, bus: str, unit: int) -> list[Restore]:
        """Return the last restores of a unit, newest first."""
        newest = "bus = ? AND unit = ? ORDER BY planned_at DESC LIMIT ?"
        return list(_select(connection, newest, bus, unit, _MAX_OF_UNIT))


def _select(connection: StoreConnection, which: str, *values: str | int) -> Iterator[Restore]:
    """Decode stored restores; leave out content that cannot be read (nothing here writes such)."""
    for (content,) in connection.execute(f"SELECT content FROM restore WHERE {which}", values).fetchall():
        try:
            yield _DECODER.decode(content)
        except (msgspec.MsgspecError, UnicodeError, RecursionError):
            continue


def _without_secrets(restore: Restore) -> Restore:
    rows = [_row_without_secret(row) for row in restore.rows]
    return replace(
        restore,
        plan=replace(restore.plan, writes=tuple(row.write for row in rows)),
        rows=rows,
        wanted=_values_without_secrets(restore.wanted),
        before=_values_without_secrets(restore.before),
        proven=restore.proven and _values_without_secrets(restore.proven),
    )


def _row_without_secret(row: RowResult) -> RowResult:
    number = row.write.number
    if not PARAMETERS[number].secret:
        return row
    return replace(row, write=Write(number, _NOT_KEPT, _NOT_KEPT), read_back=None)


def _values_without_secrets(values: UnitRows) -> UnitRows:
    """Remove secrets, and the frames, which contain them too."""
    rows = {
        number: replace(row, raw=None if PARAMETERS[number].secret else row.raw, frame=b"")
        for number, row in values.rows.items()
    }
    return replace(values, rows=rows)


EndSubscriber = Callable[[Restore], Awaitable[None]]
_STOPS = frozenset({"unverified", "not_sent", "bus_closed"})
"""The outcomes of a row after which the next rows would hardly do better."""
_log = structlog.get_logger(__name__)


class RestoreService:
    """The service that plans restores, runs at most one for each unit, and remembers them, also on disk."""

    def __init__(
        self,
        readers: Mapping[str, ParameterReader],
        commands: Mapping[str, CommandService],
        events: EventLog,
        store: RestoreStore,
    ) -> None:
        self._readers = readers
        self._commands = commands
        self._events = events
        self._store = store
        self._restores: dict[str, Restore] = {}
        self.background = Background()
        self._end_subscribers: list[EndSubscriber] = []

    def on_end(self, subscriber: EndSubscriber) -> None:
        """Call ``subscriber`` with each restore that has ended."""
        self._end_subscribers.append(subscriber)

    async def find(self, restore_id: str) -> Restore | None:
        """Return a begun restore, or a plan made since the server started."""
        return self._restores.get(restore_id) or await self._store.load(restore_id)

    async def of_unit(self, bus: str, unit: int) -> list[Restore]:
        """Return the last restores of a unit that were begun, newest first."""
        return [self._restores.get(begun.id, begun) for begun in await self._store.of_unit(bus, unit)]

    async def load(self) -> None:
        """Mark as stopped the restores that were under way when the server ended."""
        for restore in await self._store.under_way():
            restore.stop("server_ended", Message("restore_under_way_at_end"))
            await self._store.save(restore)
            await self._record(restore)

    async def plan(
        self,
        person: Person,
        bus: str,
        unit: int,
        wanted: UnitRows,
        selection: Selection = EVERYTHING_HARMLESS,
        *,
        for_swap: bool = False,
    ) -> Restore:
        """Read the unit now and plan the writes; write nothing. ``for_swap``: the unit is a spare.

        Raise Problem 503 or 504 if the unit cannot be read, 409 ``dangerous`` or 422 ``invalid`` for a row
        that the selection includes and that cannot be written.
        """
        PLAN.check(person)
        reader = self._readers[bus]
        before = await reader.read_unit(person, unit, urgent=True)
        running, remote = reader.motion(unit)
        restore = Restore(
            id=secrets.token_hex(8),
            bus=bus,
            unit=unit,
            who=person.name,
            wanted=wanted,
            before=before,
            plan=RestorePlan((), (), 0),
            rows=[],
            planned_at=unix_now(),
            running=running,
            remote=remote,
            for_swap=for_swap,
        )
        _choose(restore, selection)
        self._remember(restore)
        return restore

    def select(self, person: Person, restore: Restore, selection: Selection) -> None:
        """Choose other rows of a plan that has not begun. Raise Problem as :meth:`plan` does."""
        PLAN.check(person)
        _refuse_begun(restore)
        _choose(restore, selection)

    def start(self, person: Person, restore: Restore) -> None:
        """Begin writing. Raise Problem 409 if this was begun before or the unit is being restored."""
        START.check(person)
        _refuse_begun(restore)
        place, others = (restore.bus, restore.unit), self._restores.values()
        if any((other.bus, other.unit) == place and other.state in UNDER_WAY for other in others):
            raise Problem(409, "busy", Message.of("unit_being_restored", unit=restore.unit))
        restore.state, restore.who = "running", person.name
        self.background.begin(self._run(person, restore), f"restore {restore.id}")

    def cancel(self, person: Person, restore: Restore) -> None:
        """Stop a restore after its current row."""
        CANCEL.check(person)
        restore.cancelled_by = person.name

    async def _run(self, person: Person, restore: Restore) -> None:
        try:
            await self._carry_out(person, restore)
        except Problem as problem:
            restore.stop(problem.code, problem.message)
        except StoreError as error:
            restore.stop("store", error.message)
        except asyncio.CancelledError:
            restore.stop("server_ended", Message("restore_shut_down"))
            raise
        except Exception:
            _log.exception("a restore failed", restore=restore.id)
            restore.stop("failed", Message("restore_failed"))
        finally:
            await self._end(restore)

    async def _carry_out(self, person: Person, restore: Restore) -> None:
        """Write the reviewed rows and compare a full read with the set. Raise Problem if that fails."""
        await self._store.save(restore)
        reader = self._readers[restore.bus]
        await self._check_review(person, restore)
        for place in range(len(restore.rows)):
            await self._write_row(person, restore, place)
        restore.state = "proving"
        restore.proven = await reader.read_unit(person, restore.unit, urgent=True)
        restore.state = "different" if restore.remaining else "equal"

    async def _check_review(self, person: Person, restore: Restore) -> None:
        """Raise Problem if a plan with the unit's present values has other rows than the review."""
        if not restore.rows:
            return
        reader = self._readers[restore.bus]
        before = await reader.read_unit(person, restore.unit, urgent=True)
        running, remote = reader.motion(restore.unit)
        now = plan_restore(
            restore.wanted, before, running=running, remote=remote, selection=restore.selection
        )
        if now.writes != restore.plan.writes:
            raise Problem(409, "moved", Message("unit_changed_since_review"))

    async def _write_row(self, person: Person, restore: Restore, place: int) -> None:
        """Write one row and store its outcome. Raise Problem if it stops the restore."""
        rows, row = restore.rows, restore.rows[place]
        if restore.cancelled_by:
            who, done = restore.cancelled_by, restore.done
            raise Problem(409, "cancelled", Message.of("restore_left_off", who=who, done=done, n=len(rows)))
        if self._would_surprise(restore, row.write):
            raise Problem(409, "moved", Message("unit_started_since_review"))
        unverified = replace(row, outcome="unverified", message=Message("row_in_doubt"))
        # If nothing more gets stored, the row counts as unverified.
        await self._store.save(replace(restore, rows=[*rows[:place], unverified, *rows[place + 1 :]]))
        try:
            rows[place] = await self._send(person, restore, row)
        except asyncio.CancelledError:
            rows[place] = unverified
            raise
        except Problem as problem:
            rows[place] = replace(row, outcome="not_sent", message=problem.message)
            raise
        finally:
            await self._store.save(restore)
        _refuse_next(rows[place])

    async def _send(self, person: Person, restore: Restore, row: RowResult) -> RowResult:
        action = WriteParameter(unit=restore.unit, number=row.write.number, raw=row.write.wanted)
        try:
            result = await self._commands[restore.bus].send(person, action, confirm=True, origin="restore")
        except Problem as problem:
            # Any other refusal would also meet the other rows.
            if problem.code != "invalid":
                raise
            return replace(row, outcome="invalid", message=problem.message)
        message = result.message
        if result.outcome == "refused" and result.unit_error is not None:
            message = Message.of("row_refused", error=unit_error(result.unit_error))
        return replace(row, outcome=result.outcome, message=message, read_back=result.read_back)

    def _would_surprise(self, restore: Restore, write: Write) -> bool:
        """Return whether a row affects the machine and the unit, which runs now, did not at the review."""
        runs, _ = self._readers[restore.bus].motion(restore.unit)
        if not runs or restore.running is not False:
            return False
        return warning_of(write.number, write.wanted, running=True) is not None

    async def _end(self, restore: Restore) -> None:
        try:
            await self._store.save(restore)
            await self._record(restore)
            for subscriber in self._end_subscribers:
                await subscriber(restore)
        except StoreError as error:
            restore.cause = joined([restore.cause, error.message])

    async def _record(self, restore: Restore) -> None:
        verified = sum(row.outcome == "verified" for row in restore.rows)
        await self._events.record(
            kind=START.kind,
            who=restore.who,
            bus=restore.bus,
            unit=restore.unit,
            what=Message.of(START.event, verified=verified, n=len(restore.rows)),
            outcome=restore.state,
            message=joined([restore.cause, restore.account()]) or "",
        )

    def _remember(self, restore: Restore) -> None:
        self._restores[restore.id] = restore
        ended = [key for key, known in self._restores.items() if known.state not in UNDER_WAY]
        for key in ended[:-_MAX_ENDED]:
            del self._restores[key]


def _choose(restore: Restore, selection: Selection) -> None:
    plan = plan_restore(
        restore.wanted, restore.before, running=restore.running, remote=restore.remote, selection=selection
    )
    refuse_unwritable(plan, selection)
    restore.plan, restore.selection = plan, selection
    restore.rows = [RowResult(write) for write in plan.writes]


def _refuse_begun(restore: Restore) -> None:
    if restore.state != "planned":
        raise Problem(409, "already_started", Message.of("restore_has_begun", state=term(restore.state)))


def _refuse_next(row: RowResult) -> None:
    """Raise Problem 503 or 504 if the outcome of a row stops the restore."""
    if row.outcome is None or row.outcome not in _STOPS:
        return
    status = 504 if row.outcome == "unverified" else 503
    why = row.message or Message("nothing_more_sent")
    raise Problem(status, row.outcome, Message.of("at_row", number=row.write.number, why=why))
