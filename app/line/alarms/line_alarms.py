"""The alarms of the site, observed every second; every alarm of the site and its buses, the acts of people on
them, and the banner in the head of every page."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import Literal, NamedTuple

from app.core.web.access import Person
from app.errors import Problem, StoreError
from app.line.alarms import rules
from app.line.alarms.acts import SILENCE, SILENCE_SOUNDING, ActBody, AlarmAct
from app.line.alarms.alarm import Alarm, alarm_key, built_in
from app.line.alarms.alarm_list import ActTransaction, AlarmList, AlarmSubscriber
from app.line.alarms.bus_alarms import BusAlarms
from app.line.alarms.journal import AlarmPerformance, AlarmStore, StoredAlarm, measure
from app.line.alarms.performance import AlarmRates
from app.line.alarms.rules import NoTransitionError
from app.line.alarms.settings import BuiltInAlarmSettings
from app.line.conditions import catalogue
from app.line.conditions.catalogue import CERTIFICATE_EXPIRING, SERVER_ALARMS, TOKEN_EXPIRING
from app.line.conditions.condition import PRIORITIES
from app.line.live.fields import Fields, Translator, name_on_site
from app.people.audit.log import EventLog
from app.people.auth.store import Token
from bus.instants import Clock, ClockWatch, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message, number, term
from bus.tls import Certificate, certificate_that_counts

LOOK_EVERY_S = 60.0
Expiry = tuple[UnixTime, str]
"""The time when something expires, and its name."""


class ExpiryWatch:
    """A watch that looks every minute for tokens and certificates that have to be replaced. ``token`` and
    ``certificate`` name the one that ends first; False: none has to be replaced, None: not known yet."""

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
        """The certificate of each file that counts: of several authorities the last to end may be the one in
        use; of the server's chain, every certificate is needed."""
        self._clock = clock
        self.token: Message | Literal[False] | None = None
        self.certificate: Message | Literal[False] | None = None

    async def follow(self) -> None:
        """Check tokens and certificates every minute, until canceled."""
        while True:
            with suppress(StoreError):
                await self.look()
            await asyncio.sleep(LOOK_EVERY_S)

    async def look(self) -> None:
        """Check tokens and certificates once. Raise StoreError."""
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


def _ending(path: Path, which: Callable[..., Certificate]) -> Expiry | None:
    """Return when the certificates of a file end; None for a file without any, which the code that uses the
    file reports."""
    found = certificate_that_counts(path, which)
    return None if found is None else (found.ends_at, path.name)


SiteCondition = Callable[[], Message | bool | None]
"""A function that returns whether the condition holds, or its one subject; None: not known."""


class SiteAlarms:
    """The alarms of the site. Features add the conditions that they know by :meth:`watch`."""

    def __init__(
        self,
        store: AlarmStore,
        clock: Clock = unix_now,
        monotonic: MonotonicClock = monotonic_now,
        tuned: Sequence[BuiltInAlarmSettings] = (),
    ) -> None:
        self._conditions: dict[str, SiteCondition] = {}
        self._about: dict[str, Message | None] = {}
        """The subject of each alarm, by its code."""
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
        """Observe the conditions, and keep the journal, until canceled."""
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
        """Return the subject of an alarm, if it names one."""
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


PAUSE_EVERY = 100
"""The alarms of a large change after which the server gives other work its turn."""


class FoundAlarm(NamedTuple):
    """An alarm and the list that it is in."""

    alarm: Alarm
    list: AlarmList


class LineAlarms:
    """The alarms. An act of a person is in the audit log, in the journal and in the alarm, or nowhere."""

    def __init__(
        self,
        buses: Mapping[str, BusAlarms],
        site: SiteAlarms,
        store: AlarmStore,
        events: EventLog,
        clock: Clock = unix_now,
    ) -> None:
        self.buses = buses
        self.site = site
        self.store = store
        self._events = events
        self._clock = clock
        self._lists = (site.list, *(bus.list for bus in buses.values()))
        self._present: dict[str, Alarm] = {}
        self._by_unit: dict[tuple[str, int], dict[str, Alarm]] = {}
        self.rates = AlarmRates()
        self.subscribe(self._note)

    async def load(self) -> None:
        """Continue from the states that the last run left."""
        stored = await self.store.load()
        self.site.load(stored)
        for bus in self.buses.values():
            bus.load(stored)
        for alarm in self.every():
            self._note(alarm)

    def _note(self, alarm: Alarm) -> None:
        definition, is_present = alarm.definition, alarm.facts.state != "normal"
        if alarm.facts.state == "unack_active" and alarm.facts.since is not None:
            self.rates.note(definition.key, alarm.facts.since)
        indexes = [self._present]
        if definition.bus is not None and definition.unit is not None:
            indexes.append(self._by_unit.setdefault((definition.bus, definition.unit), {}))
        for index in indexes:
            if is_present:
                index[definition.key] = alarm
            else:
                index.pop(definition.key, None)

    async def write(self) -> None:
        """Write what is not on disk yet, as far as possible."""
        for each in self._lists:
            for work in (each.write, each.record_observed):
                with suppress(StoreError):
                    await work()

    def subscribe(self, subscriber: AlarmSubscriber) -> None:
        """Call ``subscriber`` with each alarm that has changed, of every bus and of the site, on the event
        loop and before the journal is written."""
        for each in self._lists:
            each.subscribe(subscriber)

    def places(self) -> list[tuple[str, str]]:
        """Return each bus and each of its units: ``dry-end`` and ``dry-end/4``, with the text to show."""
        places: list[tuple[str, str]] = []
        for name, bus in self.buses.items():
            places.append((name, name))
            places += [(f"{name}/{unit}", f"{name} · {text}") for unit, text in bus.unit_names().items()]
        return places

    def list_of(self, bus: str) -> AlarmList:
        """Return the alarms of a bus, or of the site if ``bus`` is empty."""
        return self.buses[bus].list if bus else self.site.list

    def every(self) -> Iterator[Alarm]:
        """Yield every alarm, of the site and of each bus."""
        for each in self._lists:
            yield from each.alarms.values()

    def known(self, key: str) -> Alarm | None:
        """Return the alarm of a key, even if its definition ended recently; None for an unknown key."""
        return next((each.known[key] for each in self._lists if key in each.known), None)

    async def measure(self, start: UnixTime, end: UnixTime) -> AlarmPerformance:
        """Return the figures of the alarm system over a span. Raise TooCostlyError."""
        present = [alarm.facts for alarm in self._present.values()]
        observed = [each.observed for each in self._lists if each.observed is not None]
        return await measure(self.store, present, observed, start, end)

    def present(self) -> list[Alarm]:
        """Return the alarms that are not normal, by :func:`rank`."""
        return sorted(self._present.values(), key=rank)

    def annunciated(self) -> list[Alarm]:
        """Return the alarms that are active or not acknowledged, and that nothing hides, in no order."""
        return [alarm for alarm in self._present.values() if alarm.is_annunciated]

    def unknown(self) -> list[Alarm]:
        """Return the alarms that were active and may have ended since, as nobody reads their unit."""
        return [alarm for alarm in self._present.values() if alarm.is_unknown]

    def tick(self) -> None:
        """Observe what time alone has changed, on every bus."""
        for bus in self.buses.values():
            bus.tick()

    def sounding(self) -> list[Alarm]:
        """Return the alarms that are audible, the most important first."""
        sounding = (alarm for alarm in self._present.values() if alarm.facts.sounds)
        return sorted(sounding, key=lambda alarm: PRIORITIES.index(alarm.definition.priority))

    def unit_alarms(self, bus: str, unit: int) -> list[Alarm]:
        """Return the annunciated and the unknown alarms of a unit, by :func:`rank`."""
        of_unit = self._by_unit.get((bus, unit), {}).values()
        return sorted((alarm for alarm in of_unit if alarm.is_annunciated or alarm.is_unknown), key=rank)

    def count_active(self, bus: str, unit: int) -> int:
        """Return the number of active annunciated alarms of a unit, as published to the plant's systems."""
        return sum(alarm.facts.active and alarm.is_annunciated for alarm in self.unit_alarms(bus, unit))

    def place(self, bus: str | None, unit: int | None) -> str:
        """Return the name of a bus, or of a unit as the pages of the site show it; empty for the site. Bus
        and unit may no longer be configured."""
        if bus is None:
            return ""
        names = self.buses[bus].unit_names() if bus in self.buses else {}
        if unit is None or unit not in names:
            return bus if unit is None else f"{bus}/{unit}"
        return name_on_site(bus, names[unit], self.buses)

    def find(self, alarm_id: str) -> FoundAlarm:
        """Return the alarm of an id. Raise Problem 404, or 409 if the id names an earlier occurrence."""
        key, _, occurrence = alarm_id.rpartition(".")
        for each in self._lists:
            alarm = each.alarms.get(key)
            if alarm is None or not occurrence.isdecimal() or not occurrence.isascii():
                continue
            if occurrence != str(alarm.facts.occurrence):
                raise Problem(
                    409, "superseded", Message.of("alarm_superseded", name=alarm.definition.name), id=alarm.id
                )
            return FoundAlarm(alarm, each)
        raise Problem(404, "unknown_alarm", Message.of("alarm_unknown", id=alarm_id[:200]))

    async def act(self, person: Person, act: AlarmAct, alarm_id: str, body: ActBody | None = None) -> Alarm:
        """Do ``act`` to the occurrence of an id; ``body``: the body of the request. Raise Problem 403, 404
        or, if the alarm has come again or its state has no such transition, 409."""
        act.check(person)
        body = body or act.body()
        async with self.find(alarm_id).list.writing:
            alarm, of = self.find(alarm_id)
            definition = alarm.definition
            try:
                changed = act.change(alarm.facts, definition.attributes, self._clock(), **body.options)
            except NoTransitionError:
                raise _not_in_state(alarm) from None
            transaction = ActTransaction(person.name, [of])
            transaction.change(of, alarm, changed, body.remark, hides=act.hides)
            performed = act.by(person, name=definition.name)
            await transaction.record(
                self._events, **performed, bus=definition.bus, unit=definition.unit, message=body.remark
            )
        return alarm

    async def silence_sounding(self, person: Person, until: UnixTime) -> None:
        """End the sound of every alarm that began to sound by ``until``; if that cannot be recorded, no alarm
        is silenced. Raise Problem 403 and StoreError."""
        SILENCE_SOUNDING.check(person)
        async with AsyncExitStack() as writing:
            for each in self._lists:
                await writing.enter_async_context(each.writing)
            await self._silence(person, until)

    async def _silence(self, person: Person, until: UnixTime) -> None:
        transaction = ActTransaction(person.name, self._lists)
        for place, alarm in enumerate(self.sounding(), 1):
            of = self.list_of(alarm.definition.bus or "")
            if (alarm.facts.since or UnixTime(0.0)) <= until:
                with suppress(NoTransitionError):
                    changed = rules.silence(alarm.facts, alarm.definition.attributes, self._clock())
                    transaction.change(of, alarm, changed)
            if place % PAUSE_EVERY == 0:
                await asyncio.sleep(0)
        if not transaction.alarms:
            return
        silenced = [alarm.definition for alarm in transaction.alarms]
        performed, bus, unit = SILENCE.by(person, name=silenced[0].name), silenced[0].bus, silenced[0].unit
        if len(silenced) > 1:
            performed, unit = SILENCE_SOUNDING.by(person, n=len(silenced)), None
            bus = bus if len({each.bus for each in silenced}) == 1 else None
        await transaction.record(self._events, **performed, bus=bus, unit=unit)


def _not_in_state(alarm: Alarm) -> Problem:
    state = alarm.facts.state
    message = Message.of(
        "alarm_not_in_state", name=alarm.definition.name, state=Message(f"alarm_state_{state}")
    )
    return Problem(409, "not_in_state", message, state=state, id=alarm.id)


def rank(alarm: Alarm) -> tuple[bool, bool, int, float]:
    """Return the place of an alarm in every list: active before cleared, then by priority, the newest first;
    hidden alarms last. An unknown one may still be active. An acknowledgement moves no alarm."""
    facts = alarm.facts
    return (
        facts.is_hidden and not alarm.is_unknown,
        not facts.active,
        PRIORITIES.index(alarm.definition.priority),
        -float(facts.came or UnixTime(0.0)),
    )


class AlarmBanner:
    """The fields of alarms in the head of every page and on the tiles. ``changed`` is another text after each
    change, so that an open summary draws itself again."""

    def __init__(self, alarms: LineAlarms) -> None:
        self._alarms = alarms
        self._changed = 0
        alarms.subscribe(self._note)

    def _note(self, _: Alarm) -> None:
        self._changed += 1

    def banner(self, translator: Translator) -> Fields:
        """Return the mark of the first alarm, the numbers of active and of unknown alarms, and the number
        that waits for an acknowledgement. Of alarms as urgent as the first, one that waits comes before the
        others."""
        found = self._alarms.annunciated()
        first = min(found, key=lambda alarm: (rank(alarm)[:3], not alarm.is_unacknowledged), default=None)
        active, waiting = alarm_counts(
            sum(alarm.facts.active and not alarm.is_unknown for alarm in found),
            sum(alarm.is_unacknowledged for alarm in found),
            len(self._alarms.unknown()),
        )
        return {
            "mark": first.mark if first else "",
            "active": translator.t(active),
            "waiting": translator.t(waiting) if waiting else "",
            "changed": str(self._changed),
            **self._sound(),
        }

    def _sound(self) -> Fields:
        """Return the priority that sounds, and when the newest alarm that sounds began to."""
        sounding = self._alarms.sounding()
        if not sounding:
            return {"sound": "", "sound_at": ""}
        at = max(float(alarm.facts.since or 0.0) for alarm in sounding)
        return {"sound": sounding[0].definition.priority, "sound_at": repr(at)}

    def unit_fields(self, bus: str, unit: int, translator: Translator, now: UnixTime) -> Fields:
        """Return the first alarm of a unit, as it is drawn and in words, its page, and the number of
        others."""
        found = self._alarms.unit_alarms(bus, unit)
        first = found[0] if found else None
        fields = _state(first, len(found), translator, now)
        name = translator.t(first.definition.name) if first else ""
        said = f"{name}, {translator.t(term(first.definition.priority))}" if first else ""
        return {"alarm": first.mark if first else "", "alarm_text": name, "alarm_said": said} | {
            f"alarm_{field}": text for field, text in fields.items()
        }

    def delay_s(self, place: str, code: str) -> float:
        """Return after how many seconds a condition of a unit (``dry-end/4``) or bus becomes an alarm; 0 if
        it is one, or something hides it."""
        alarm = self._of(place, code)
        if alarm is None or alarm.facts.active or alarm.facts.is_hidden:
            return 0.0
        return alarm.definition.attributes.on_delay_s

    def since(self, place: str, code: str) -> UnixTime | None:
        """Return since when a condition of a unit or bus is an active alarm; None if it is none. A gap in
        which nobody knows it does not change that time."""
        alarm = self._of(place, code)
        if alarm is None or not alarm.is_annunciated or not alarm.facts.active:
            return None
        return alarm.facts.came or alarm.facts.since

    def shelved_until(self, place: str, code: str) -> UnixTime | None:
        """Return until when the alarm of a condition of a unit or bus is shelved; None if it is not."""
        alarm = self._of(place, code)
        return None if alarm is None else alarm.facts.shelved_until

    def _of(self, place: str, code: str) -> Alarm | None:
        bus, _, unit = place.partition("/")
        return self._alarms.known(alarm_key(bus, int(unit) if unit else None, code))


def alarm_counts(active: int, waiting: int, unknown: int = 0) -> tuple[Message, Message | None]:
    """Return the number of active alarms, with those that are ``unknown`` since they were active, and the
    number that waits for an acknowledgement, whether active or not; None if none does."""
    if unknown and active:
        counted = Message.of("alarms_active_and_unknown", n=active, unknown=unknown)
    elif unknown:
        counted = Message.of("alarms_unknown", n=unknown)
    elif active:
        counted = Message.of("alarms_active", n=active)
    else:
        counted = Message("no_alarm_active" if waiting else "no_alarms")
    return counted, Message.of("alarms_waiting", n=waiting) if waiting else None


def _state(alarm: Alarm | None, count: int, translator: Translator, now: UnixTime) -> Fields:
    """Return the state of the first of ``count`` alarms with its time (of a cleared alarm, when it cleared),
    the number of others, and the page of the first."""
    if alarm is None:
        return {"state": "", "more": "", "at": ""}
    code = "alarm_active_since" if alarm.facts.unknown_since is None else "alarm_unknown_since"
    code = code if alarm.facts.active else "alarm_cleared_at"
    time = translator.formats.since(alarm.state_at or now, now)
    return {
        "state": translator.t(Message.of(code, time=time)),
        "more": f" · {translator.t(Message.of('alarms_more', n=count - 1))}" if count > 1 else "",
        "at": f"/alarms/{alarm.id}",
    }
