"""The alarms of the site: its records, its disk, its clock, and what expires."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal

from app.alarms.alarm import Alarm
from app.alarms.alarm_list import AlarmList
from app.alarms.catalogue import built_in
from app.alarms.definition import key_of
from app.alarms.expiry_watch import ExpiryWatch
from app.alarms.settings import BuiltInAlarmSettings, tuning_of
from app.alarms.store import AlarmStore, StoredAlarm
from app.audit.anchoring import AnchorStatus
from app.conditions import of_server
from app.conditions.catalogue import SERVER_ALARMS
from app.history.intake.clock_watch import ClockWatch
from app.history.status import HistoryStatus
from bus.instants import Clock, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message, number

SiteCondition = Callable[[], bool | None]
SiteValue = Callable[[], Message | None]


class FailingEndpoints(set[str]):
    """The addresses of notification that cannot be reached now. Notification keeps it up to date."""


def site_conditions(
    history: Callable[[], HistoryStatus],
    anchor: Callable[[], AnchorStatus],
    failing_endpoints: FailingEndpoints,
    expiry: ExpiryWatch,
) -> dict[str, SiteCondition]:
    """Whether the condition of each alarm of the site holds; None: not known."""
    return {
        "history_degraded": lambda: of_server.HISTORY_DEGRADED.holds(history().state),
        "disk_low": lambda: of_server.DISK_LOW.holds(history().state),
        "audit_degraded": lambda: of_server.AUDIT_DEGRADED.holds(
            anchor() != AnchorStatus(since=anchor().since)
        ),
        "notification_failed": lambda: of_server.NOTIFICATION_FAILED.holds(failing_endpoints),
        "certificate_expiring": lambda: expiry.certificate is not None if expiry.is_known else None,
        "token_expiring": lambda: expiry.token is not None if expiry.is_known else None,
    }


def site_values(expiry: ExpiryWatch) -> dict[str, SiteValue]:
    """What those that are about one thing name."""
    return {"certificate_expiring": lambda: expiry.certificate, "token_expiring": lambda: expiry.token}


class SiteAlarms:
    """Looks at them every second."""

    def __init__(
        self,
        conditions: Mapping[str, SiteCondition],
        values: Mapping[str, SiteValue],
        store: AlarmStore,
        clock: Clock = unix_now,
        monotonic: MonotonicClock = monotonic_now,
        tuned: Sequence[BuiltInAlarmSettings] = (),
    ) -> None:
        self._conditions = conditions
        self._values = {key_of(None, None, code): value for code, value in values.items()}
        self._clock, self._monotonic = clock, monotonic
        self._clock_watch = ClockWatch(clock(), monotonic())
        self._step: Message | None = None
        self.list = AlarmList(
            (built_in(code, None, None, tuning_of(tuned, code, None, None)) for code in SERVER_ALARMS), store
        )
        self._clock_stepped = self.list.alarms[key_of(None, None, of_server.CLOCK_STEPPED.code)]

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
        for code, holds in self._conditions.items():
            self.list.observe(self.list.alarms[key_of(None, None, code)], holds(), now)

    def present(self, alarm: Alarm) -> Message | None:
        """What an alarm is about, where it names one thing."""
        value = self._values.get(alarm.definition.key)
        if value is None:
            return self._step if alarm is self._clock_stepped else None
        return value()

    def _see_clock(self, now: UnixTime) -> None:
        """A step is over at once; the off-delay of its alarm keeps it active for a while."""
        step_s = self._clock_watch.step(now, self._monotonic())
        if step_s:
            self.list.clock_stepped(step_s)
            self._step = Message.of("alarm_clock_step", seconds=number(Decimal(f"{step_s:.1f}")))
        self.list.observe(self._clock_stepped, of_server.CLOCK_STEPPED.holds(step_s), now)
