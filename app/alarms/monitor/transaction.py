"""What a person changes is on disk with its event in one transaction, or it did not happen."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

from typing_extensions import Unpack

from app.alarms.alarm import Alarm
from app.alarms.journal.store import alarm_writer
from app.alarms.monitor.alarm_list import AlarmList
from app.alarms.rules.state_machine import Changed
from app.audit.entry import EventKind
from app.audit.log import Also, EventFields, EventLog
from app.database import StoreConnection
from app.errors import StoreError


class ActTransaction:
    """The changes of one act to alarms of ``lists``; ``who``: the name of the person. The caller holds
    ``writing`` of each list until it is recorded."""

    def __init__(self, who: str, lists: Iterable[AlarmList]) -> None:
        self._who = who
        self._lists = tuple(lists)
        self._undo: list[Callable[[], None]] = []
        self.alarms: list[Alarm] = []
        """The alarms that were changed."""

    def change(
        self, of: AlarmList, alarm: Alarm, changed: Changed, reason: str = "", *, hides: bool = False
    ) -> None:
        """Change an alarm of a list; where that ``hides`` it, it keeps by whom and why."""
        before = (alarm.facts, alarm.hidden_by, alarm.reason)
        if hides:
            alarm.hidden_by, alarm.reason = self._who, reason
        of.apply(alarm, changed, self._who, reason)
        self._undo.append(partial(of.restore, alarm, *before, unless_changed_from=alarm.facts))
        self.alarms.append(alarm)

    async def record(
        self,
        events: EventLog,
        *beside: Also,
        kind: EventKind,
        **fields: Unpack[EventFields],
    ) -> None:
        """Record the act in the audit log, with the journal and what is written ``beside`` it. Raises
        StoreError; every alarm is then as it was before, unless it has changed since."""
        taken = [(each, *each.take_unwritten()) for each in self._lists]
        written = [*beside, *(alarm_writer(entries, alarms) for _, entries, alarms in taken)]

        def write(connection: StoreConnection) -> None:
            for each in written:
                each(connection)

        try:
            await events.record(kind=kind, **fields, also=write)
        except StoreError:
            for each, entries, alarms in taken:
                each.give_back([entry for entry in entries if entry.who != self._who], alarms)
            for undo in self._undo:
                undo()
            raise
