"""One restore from start to end: the review checked, each row verified, all verified by a full read."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace

from app.core.web.admission.access import Person
from app.engineering.sets.restore.effects import warning_of
from app.engineering.sets.restore.plan import plan_restore
from app.engineering.sets.restore.record import Restore, RowResult
from app.engineering.sets.restore.store import RestoreStore
from app.engineering.sets.saving.reading import ParameterReader
from app.errors import Problem
from app.line.commands.service.command_service import CommandService
from bus.contract import WriteParameter
from bus.errors import unit_error
from bus.messages import Message

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
