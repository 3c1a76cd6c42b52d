"""Restores: planned, reviewed, started, and stored with the outcome of each row.

Nothing is written before a person has seen the plan. However it is stopped, the rows state
exactly what was done; the same restore again finds the done rows equal and finishes the rest.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable, Mapping

import structlog

from app.core.web.admission.access import Person
from app.engineering.sets.acts import CANCEL, PLAN, START
from app.engineering.sets.model import UnitRows
from app.engineering.sets.restore.plan import (
    EVERYTHING_HARMLESS,
    RestorePlan,
    Selection,
    plan_restore,
    refuse_unwritable,
)
from app.engineering.sets.restore.record import UNDER_WAY, Restore, RowResult
from app.engineering.sets.restore.run import RestoreRun
from app.engineering.sets.restore.store import RestoreStore
from app.engineering.sets.saving.background import Background
from app.engineering.sets.saving.reading import ParameterReader
from app.errors import Problem, StoreError
from app.line.commands.service.command_service import CommandService
from app.people.audit.log import EventLog
from bus.instants import unix_now
from bus.messages import Message, joined, term

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

    async def load(self, bus: str) -> None:
        """Mark the restores of a bus that were running when the last run ended as stopped."""
        self._restores = {key: restore for key, restore in self._restores.items() if restore.bus != bus}
        for restore in await self._store.under_way(bus):
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
        self.background.begin(self._run(person, restore), f"restore {restore.id}", restore.bus)

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
