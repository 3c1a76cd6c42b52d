"""The alarms of the site: its records and its disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from app.alarms.alarm_list import AlarmList
from app.alarms.catalogue import SITE_ALARMS, SiteAlarm, built_in
from app.alarms.definition import key_of
from app.alarms.store import AlarmStore, StoredAlarm
from app.audit.anchoring import AnchorStatus
from app.history.status import Status
from bus.instants import Clock, unix_now

SiteCondition = Callable[[], bool]
_DEGRADED = frozenset(("paused", "failed"))
_LOW = frozenset(("low", "scarce", "paused"))


def site_conditions(
    history: Callable[[], Status], anchor: Callable[[], AnchorStatus], notification_failed: SiteCondition
) -> dict[SiteAlarm, SiteCondition]:
    """Whether the condition of each alarm of the site holds."""
    return {
        "history_degraded": lambda: history().state in _DEGRADED,
        "disk_low": lambda: history().state in _LOW,
        "audit_degraded": lambda: anchor() != AnchorStatus(since=anchor().since),
        "notification_failed": notification_failed,
    }


class SiteAlarms:
    """Looks at them every second."""

    def __init__(
        self, conditions: Mapping[SiteAlarm, SiteCondition], store: AlarmStore, clock: Clock = unix_now
    ) -> None:
        self._conditions = conditions
        self._clock = clock
        self.list = AlarmList((built_in(code, None) for code in SITE_ALARMS), store)

    def load(self, stored: Mapping[str, StoredAlarm]) -> None:
        """Take up the states that the last run left."""
        self.list.load(stored, self._clock())

    async def follow(self) -> None:
        """Look, and keep the journal, without end."""
        await self.list.follow(self.tick, self._clock)

    def tick(self) -> None:
        """Look once."""
        now = self._clock()
        for code, holds in self._conditions.items():
            self.list.observe(self.list.alarms[key_of(None, None, code)], holds(), now)
