"""The alarms of the site, observed every second, and a watch for certificates and tokens that expire."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import Literal

from app.errors import StoreError
from app.line.alarms.alarm import Alarm, alarm_key, built_in
from app.line.alarms.alarm_list import AlarmList
from app.line.alarms.journal import AlarmStore, StoredAlarm
from app.line.alarms.settings import BuiltInAlarmSettings
from app.line.conditions import catalogue
from app.line.conditions.catalogue import CERTIFICATE_EXPIRING, SERVER_ALARMS, TOKEN_EXPIRING
from app.people.auth.store import Token
from bus.instants import Clock, ClockWatch, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message, number
from bus.tls import MalformedCertificateError, certificates_in

LOOK_EVERY_S = 60.0
Expiry = tuple[UnixTime, str]
"""When something expires, and its name."""


class ExpiryWatch:
    """Looks every minute for tokens and certificates that have to be replaced. ``token`` and ``certificate``
    name the one that ends first; False: none has to be replaced, None: not known yet."""

    def __init__(
        self,
        tokens: Callable[[], Awaitable[list[Token]]],
        authorities: Iterable[Path],
        clock: Clock = unix_now,
        *,
        certificates: Iterable[Path] = (),
    ) -> None:
        self._tokens = tokens
        self._ends = {**dict.fromkeys(authorities, max), **dict.fromkeys(certificates, min)}
        """Which certificate of each file counts: of several authorities the last to end may be the one in
        use; of the server's chain, every certificate is needed."""
        self._clock = clock
        self.token: Message | Literal[False] | None = None
        self.certificate: Message | Literal[False] | None = None

    async def follow(self) -> None:
        """Look every minute, without end."""
        while True:
            with suppress(StoreError):
                await self.look()
            await asyncio.sleep(LOOK_EVERY_S)

    async def look(self) -> None:
        """Look once. Raises StoreError."""
        now = self._clock()
        self.token = _first(
            (token.expires_at, token.name)
            for token in await self._tokens()
            if token.expires_at is not None
            and TOKEN_EXPIRING.holds(token.created_at, token.expires_at, token.used_at, now)
        )
        endings = await asyncio.to_thread(lambda: [_ending(*each) for each in self._ends.items()])
        self.certificate = _first(
            each for each in endings if each and CERTIFICATE_EXPIRING.holds(each[0], now)
        )


def _first(endings: Iterable[Expiry]) -> Message | Literal[False]:
    at, name = min(endings, default=(None, ""))
    if at is None:
        return False
    day = datetime.fromtimestamp(float(at), UTC).date().isoformat()
    return Message.of("alarm_expires", name=name, day=day)


def _ending(path: Path, which: Callable[[Iterable[UnixTime]], UnixTime]) -> Expiry | None:
    """Return when the certificates of a file end; None for a file without any, which the code that uses the
    file reports."""
    try:
        found = certificates_in(path.read_text(encoding="ascii", errors="replace"))
    except (OSError, MalformedCertificateError):
        return None
    return which(each.ends_at for each in found), path.name


SiteCondition = Callable[[], Message | bool | None]
"""Returns whether the condition holds, or what it is about where that is one thing; None: not known."""


class SiteAlarms:
    """The alarms of the site. The features that know their conditions add them by :meth:`watch`."""

    def __init__(
        self,
        store: AlarmStore,
        clock: Clock = unix_now,
        monotonic: MonotonicClock = monotonic_now,
        tuned: Sequence[BuiltInAlarmSettings] = (),
    ) -> None:
        self._conditions: dict[str, SiteCondition] = {}
        self._about: dict[str, Message | None] = {}
        """What an alarm is about, by its code."""
        self._clock, self._monotonic = clock, monotonic
        self._clock_watch = ClockWatch(clock(), monotonic())
        self.list = AlarmList((built_in(code, None, None, tuned) for code in SERVER_ALARMS), store)

    def watch(self, code: str, condition: SiteCondition) -> None:
        """Observe an alarm by a condition of the feature that knows it."""
        self._conditions[code] = condition

    def load(self, stored: Mapping[str, StoredAlarm]) -> None:
        """Continue from the states that the last run left."""
        self.list.load(stored, self._clock())

    async def follow(self) -> None:
        """Observe the conditions, and keep the journal, without end."""
        await self.list.follow(self.tick, self._clock)

    def tick(self) -> None:
        """Observe every condition once."""
        now = self._clock()
        self._see_clock(now)
        for code, condition in self._conditions.items():
            found = condition()
            self._about[code] = found if isinstance(found, Message) else None
            self._observe(code, None if found is None else bool(found), now)

    def present(self, alarm: Alarm) -> Message | None:
        """Return what an alarm is about, where it names one thing."""
        return self._about.get(alarm.definition.code)

    def _observe(self, code: str, holds: bool | None, now: UnixTime) -> None:
        self.list.observe(self.list.alarms[alarm_key(None, None, code)], holds, now)

    def _see_clock(self, now: UnixTime) -> None:
        """Observe the clock. A step is over at once; the off-delay keeps its alarm active for a while."""
        step_s = self._clock_watch.step(now, self._monotonic())
        if step_s:
            self.list.clock_stepped(step_s)
            step = Message.of("alarm_clock_step", seconds=number(Decimal(f"{step_s:.1f}")))
            self._about[catalogue.CLOCK_STEPPED.code] = step
        self._observe(catalogue.CLOCK_STEPPED.code, catalogue.CLOCK_STEPPED.holds(step_s), now)
