"""Stores restores: the state of each before a row is sent, and again with the outcome of the row.

One restore from start to end: the review checked, each row verified, all verified by a full read.

Restores: planned, reviewed, started, and stored with the outcome of each row.

Nothing is written before a person has seen the plan. However it is stopped, the rows state
exactly what was done; the same restore again finds the done rows equal and finishes the rest.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import msgspec
import structlog

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.core.database.database import Tables, reading
from app.core.lifespan import Background
from app.core.web.admission.access import Person
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
    warning_of,
)
from app.engineering.sets.saving import ParameterReader
from app.errors import Problem, StoreError
from app.line.commands.catalogue import WRITE_PARAMETER
from app.line.commands.service.command_service import CommandService
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
"""A restore writes parameters, whose role it needs; it is recorded once, when it has ended."""

NOT_KEPT = -1
"""Stands for a secret (#21), which is kept in parameter sets alone: no raw value is negative."""
MAX_OF_UNIT = 20
_SAVE = upsert("restore", ("id",), ("bus", "unit", "planned_at", "state", "content"))
_DECODER = msgspec.json.Decoder(Restore)


class RestoreStore(Tables):
    """All access to the table of restores. Only what was begun is kept; a plan writes nothing."""

    async def save(self, restore: Restore) -> None:
        """Store its present state in place of the earlier one, without secrets."""
        one, content = restore, msgspec.json.encode(_without_secrets(restore)).decode()
        row = (one.id, one.bus, one.unit, one.planned_at, one.state, content)
        await self.database.write(lambda connection: connection.execute(_SAVE, row))

    @reading
    def load(self, connection: StoreConnection, restore_id: str) -> Restore | None:
        """A restore that was begun, None when there is no such."""
        return next(_select(connection, "id = ?", restore_id), None)

    @reading
    def under_way(self, connection: StoreConnection) -> list[Restore]:
        """Return the restores that had not ended when the server did."""
        marks = ", ".join("?" * len(UNDER_WAY))
        return list(_select(connection, f"state IN ({marks})", *UNDER_WAY))

    @reading
    def of_unit(self, connection: StoreConnection, bus: str, unit: int) -> list[Restore]:
        """The last restores of a unit, newest first."""
        newest = "bus = ? AND unit = ? ORDER BY planned_at DESC LIMIT ?"
        return list(_select(connection, newest, bus, unit, MAX_OF_UNIT))


def _select(connection: StoreConnection, which: str, *values: str | int) -> Iterator[Restore]:
    """Content that cannot be read, which nothing here writes, is left out."""
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
    return replace(row, write=Write(number, NOT_KEPT, NOT_KEPT), read_back=None)


def _values_without_secrets(values: UnitRows) -> UnitRows:
    """The frames, which hold the values too, are left out."""
    rows = {
        number: replace(row, raw=None if PARAMETERS[number].secret else row.raw, frame=b"")
        for number, row in values.rows.items()
    }
    return replace(values, rows=rows)


ENDED_MEANWHILE = Message("row_in_doubt")
_STOPS = frozenset({"unverified", "not_sent", "bus_closed"})
"""Outcomes of a row after which the others cannot be expected to do better."""


@dataclass(frozen=True, slots=True, eq=False)
class RestoreRun:
    """Carries out what was reviewed, for ``person``. Raises Problem for whatever stops it."""

    _reader: ParameterReader
    _commands: CommandService
    _store: RestoreStore
    _person: Person
    _restore: Restore

    async def run(self) -> None:
        """Leaves the restore ``equal`` or ``different``."""
        restore = self._restore
        await self._store.save(restore)
        await self._check_review()
        await self._write_rows()
        restore.state = "proving"
        restore.proven = await self._reader.read_unit(self._person, restore.unit, urgent=True)
        restore.state = "different" if restore.remaining else "equal"

    async def _check_review(self) -> None:
        """Plan again with the unit's present values: a review of other rows or values does not count."""
        restore = self._restore
        if not restore.rows:
            return
        before = await self._reader.read_unit(self._person, restore.unit, urgent=True)
        running, remote = self._reader.motion(restore.unit)
        now = plan_restore(
            restore.wanted, before, running=running, remote=remote, selection=restore.selection
        )
        if now.writes != restore.plan.writes:
            raise Problem(409, "moved", Message("unit_changed_since_review"))

    async def _write_rows(self) -> None:
        restore = self._restore
        for place, row in enumerate(restore.rows):
            if restore.cancelled_by:
                who, done, n = restore.cancelled_by, restore.done, len(restore.rows)
                raise Problem(409, "cancelled", Message.of("restore_left_off", who=who, done=done, n=n))
            if self._would_surprise(row):
                raise Problem(409, "moved", Message("unit_started_since_review"))
            unverified = replace(row, outcome="unverified", message=ENDED_MEANWHILE)
            # Should nothing more be stored, the row counts as unverified.
            await self._store.save(
                replace(restore, rows=[*restore.rows[:place], unverified, *restore.rows[place + 1 :]])
            )
            try:
                restore.rows[place] = await self._write(row)
            except asyncio.CancelledError:
                restore.rows[place] = unverified
                raise
            except Problem as problem:
                restore.rows[place] = replace(row, outcome="not_sent", message=problem.message)
                raise
            finally:
                await self._store.save(restore)
            _go_on_or_raise(restore.rows[place])

    async def _write(self, row: RowResult) -> RowResult:
        restore, write = self._restore, row.write
        action = WriteParameter(unit=restore.unit, number=write.number, raw=write.wanted)
        try:
            result = await self._commands.send(self._person, action, confirm=True, origin="restore")
        except Problem as problem:
            # Any other refusal concerns the other rows too.
            if problem.code != "invalid":
                raise
            return replace(row, outcome="invalid", message=problem.message)
        message = result.message
        if result.outcome == "refused" and result.unit_error is not None:
            message = Message.of("row_refused", error=unit_error(result.unit_error))
        return replace(row, outcome=result.outcome, message=message, read_back=result.read_back)

    def _would_surprise(self, row: RowResult) -> bool:
        """Whether this row changes what a unit does that runs now and did not when it was reviewed."""
        runs, _ = self._reader.motion(self._restore.unit)
        if not runs or self._restore.running is not False:
            return False
        return warning_of(row.write.number, row.write.wanted, running=True) is not None


def _go_on_or_raise(row: RowResult) -> None:
    if row.outcome is None or row.outcome not in _STOPS:
        return
    status = 504 if row.outcome == "unverified" else 503
    why = row.message or Message("nothing_more_sent")
    raise Problem(status, row.outcome, Message.of("at_row", number=row.write.number, why=why))


EndSubscriber = Callable[[Restore], Awaitable[None]]

_log = structlog.get_logger(__name__)

MAX_ENDED = 50
"""Plans and ended restores that are kept in memory."""


class RestoreService:
    """Plans restores, runs them one at a time per unit, and remembers how they went, also on disk."""

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
        """A restore planned since the server started, or begun at any time."""
        return self._restores.get(restore_id) or await self._store.load(restore_id)

    async def of_unit(self, bus: str, unit: int) -> list[Restore]:
        """The last restores of a unit that were begun, newest first."""
        return [self._restores.get(begun.id, begun) for begun in await self._store.of_unit(bus, unit)]

    async def load(self) -> None:
        """Mark the restores that were under way when the server ended as stopped."""
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
        """Read the unit now and plan the writes; nothing is written. ``for_swap``: to a spare.

        Raises Problem 503 or 504 when the unit cannot be read, 409 ``dangerous`` or 422 ``invalid`` for a row
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
        """Choose other rows of a plan that has not begun. Raises Problem as :meth:`plan` does."""
        PLAN.check(person)
        _refuse_begun(restore)
        _choose(restore, selection)

    def start(self, person: Person, restore: Restore) -> None:
        """Begin writing. Raises Problem 409 when it has begun already or its unit is being restored."""
        START.check(person)
        _refuse_begun(restore)
        place, others = (restore.bus, restore.unit), self._restores.values()
        if any((other.bus, other.unit) == place and other.state in UNDER_WAY for other in others):
            raise Problem(409, "busy", Message.of("unit_being_restored", unit=restore.unit))
        restore.state, restore.who = "running", person.name
        self.background.begin(self._run(person, restore), f"restore {restore.id}")

    def cancel(self, person: Person, restore: Restore) -> None:
        """Stop it after the current row."""
        CANCEL.check(person)
        restore.cancelled_by = person.name

    async def _run(self, person: Person, restore: Restore) -> None:
        try:
            reader, commands = self._readers[restore.bus], self._commands[restore.bus]
            await RestoreRun(reader, commands, self._store, person, restore).run()
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
        for key in ended[:-MAX_ENDED]:
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
