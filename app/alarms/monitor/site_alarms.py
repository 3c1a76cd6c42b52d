"""The alarms of the site: its records, its disk, its clock, and what expires."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal

from app.alarms.alarm import Alarm, key_of
from app.alarms.catalogue import built_in
from app.alarms.journal.store import AlarmStore, StoredAlarm
from app.alarms.monitor.alarm_list import AlarmList
from app.alarms.monitor.expiry_watch import ExpiryWatch
from app.alarms.settings import BuiltInAlarmSettings
from app.audit.anchor import AnchorStatus
from app.conditions import of_server
from app.conditions.catalogue import SERVER_ALARMS
from app.history.status import HistoryStatus
from bus.instants import Clock, ClockWatch, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message, number

SiteCondition = Callable[[], Message | bool | None]
"""Whether it holds, or what it is about where it names one thing; None: not known."""


class FailingEndpoints(set[str]):
    """The addresses of notification that cannot be reached now. Notification keeps it up to date."""


def site_conditions(
    history: Callable[[], HistoryStatus],
    anchor: Callable[[], AnchorStatus],
    failing_endpoints: FailingEndpoints,
    expiry: ExpiryWatch,
    backup_missing: SiteCondition = lambda: None,
    archive_fault: Callable[[], Message | None] = lambda: None,
) -> dict[str, SiteCondition]:
    """The condition of each alarm of the site but that of its clock."""
    return {
        "history_degraded": lambda: of_server.HISTORY_DEGRADED.holds(history().state),
        "disk_low": lambda: of_server.DISK_LOW.holds(history().state),
        "audit_degraded": lambda: of_server.AUDIT_DEGRADED.holds(
            anchor() != AnchorStatus(since=anchor().since)
        ),
        "notification_failed": lambda: of_server.NOTIFICATION_FAILED.holds(failing_endpoints),
        "certificate_expiring": lambda: expiry.certificate,
        "token_expiring": lambda: expiry.token,
        "backup_overdue": backup_missing,
        "events_not_archived": lambda: of_server.EVENTS_NOT_ARCHIVED.holds(archive_fault()),
    }


class SiteAlarms:
    """Looks at them every second."""

    def __init__(
        self,
        conditions: Mapping[str, SiteCondition],
        store: AlarmStore,
        clock: Clock = unix_now,
        monotonic: MonotonicClock = monotonic_now,
        tuned: Sequence[BuiltInAlarmSettings] = (),
    ) -> None:
        self._conditions = conditions
        self._about: dict[str, Message | None] = {}
        """By the code of an alarm, what it is about."""
        self._clock, self._monotonic = clock, monotonic
        self._clock_watch = ClockWatch(clock(), monotonic())
        self.list = AlarmList((built_in(code, None, None, tuned) for code in SERVER_ALARMS), store)

    def load(self, stored: Mapping[str, StoredAlarm]) -> None:
        """Take up the states that the last run left."""
        self.list.load(stored, self._clock())

    async def follow(self) -> None:
        """Look, and keep the journal, without end."""
        await self.list.follow(self.tick, self._clock)

    def tick(self) -> None:
        """Look once."""
        now = self._clock()
        self._see_clock(now)
        for code, condition in self._conditions.items():
            found = condition()
            self._about[code] = found if isinstance(found, Message) else None
            self._observe(code, None if found is None else bool(found), now)

    def present(self, alarm: Alarm) -> Message | None:
        """What an alarm is about, where it names one thing."""
        return self._about.get(alarm.definition.code)

    def _observe(self, code: str, holds: bool | None, now: UnixTime) -> None:
        self.list.observe(self.list.alarms[key_of(None, None, code)], holds, now)

    def _see_clock(self, now: UnixTime) -> None:
        """A step is over at once; the off-delay of its alarm keeps it active for a while."""
        step_s = self._clock_watch.step(now, self._monotonic())
        if step_s:
            self.list.clock_stepped(step_s)
            step = Message.of("alarm_clock_step", seconds=number(Decimal(f"{step_s:.1f}")))
            self._about[of_server.CLOCK_STEPPED.code] = step
        self._observe(of_server.CLOCK_STEPPED.code, of_server.CLOCK_STEPPED.holds(step_s), now)
