"""The rules of notification: the alarms to notify, the people on duty, recurring maintenance, and the next
message of an address; and the plan that makes addresses and rules of the configuration. Pure: transitions,
settings and times are passed in.

An episode is the time in which an alarm waits for its acknowledgement; rules are followed within it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, datetime, time, timedelta
from hashlib import blake2b
from typing import Literal
from urllib.parse import urlsplit
from zoneinfo import ZoneInfo

from app.line.alarms.journal import JournalEntry
from app.line.alarms.rules import AlarmState
from app.line.conditions.condition import AlarmPriority
from app.records.notification.settings import (
    DAYS,
    AppriseSettings,
    GroupSettings,
    MaintenanceSettings,
    NotifySettings,
    SmtpSettings,
    WebhookSettings,
    clock_of,
    minute_of_day,
)
from bus.errors import LinesideError
from bus.instants import UnixTime
from bus.messages import Message

UNACKNOWLEDGED: frozenset[AlarmState] = frozenset(("unack_active", "rtn_unack", "latched_unack"))
LATE_S = 3600.0
"""The age above which an alarm that came and went is not notified: the server was off meanwhile."""
MINUTES_OF_DAY = 24 * 60
MINUTES_OF_WEEK = 7 * MINUTES_OF_DAY
_DAY = timedelta(days=1)
_MINUTE = timedelta(minutes=1)
DeliveryState = Literal["sending", "retrying", "delivered", "failed", "canceled"]
"""The state of a delivery. It begins as ``sending``, on disk before the first byte leaves. If the server ends
in between, the message may have left: the delivery is ``retrying``, with the same id. ``canceled``: its
address is no longer configured. A delivered, failed or canceled message is never sent again."""
FIRST_RETRY_S = 5.0
MAX_RETRY_S = 900.0
GIVE_UP_S = 86_400.0
FLOOD_WINDOW_S = 600.0
FAILING_ATTEMPTS = 2
"""The number of failures without a success between after which an address is failing."""


# --- the people on duty --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DutyPeriod:
    """A time of duty: ``minutes`` from the minute ``starts`` of each of ``days`` (Monday is 0)."""

    days: frozenset[int]
    starts: int
    minutes: int
    to: tuple[str, ...]

    def covers(self, minute: int) -> bool:
        """Return whether the period includes a minute of the week."""
        return any(
            (minute - day * MINUTES_OF_DAY - self.starts) % MINUTES_OF_WEEK < self.minutes
            for day in self.days
        )


@dataclass(frozen=True, slots=True)
class DutyRoster:
    """The addresses of a group. ``always``: addresses notified at any time; ``periods``: the others."""

    always: tuple[str, ...] = ()
    periods: tuple[DutyPeriod, ...] = ()

    def on_duty(self, local: datetime) -> tuple[str, ...]:
        """Return the addresses at a local time; in a gap all of the group: too many are better than none."""
        minute = minute_of_week(local)
        present = (*self.always, *(to for each in self.periods if each.covers(minute) for to in each.to))
        return tuple(dict.fromkeys(present)) or self.addresses()

    def addresses(self) -> tuple[str, ...]:
        """Return every address of the group."""
        return tuple(dict.fromkeys((*self.always, *(to for each in self.periods for to in each.to))))

    def gaps(self) -> list[tuple[int, int]]:
        """Return the spans of a week in which no address is on duty: the first minute, and the first minute
        after the gap. A gap over the end of the week is returned in two parts."""
        found: list[tuple[int, int]] = []
        if self.always:
            return found
        for minute in range(MINUTES_OF_WEEK):
            if any(each.covers(minute) for each in self.periods):
                continue
            if found and found[-1][1] == minute:
                found[-1] = (found[-1][0], minute + 1)
            else:
                found.append((minute, minute + 1))
        return found


def minute_of_week(local: datetime) -> int:
    """Return the minute of the week; Monday 00:00 is 0."""
    return local.weekday() * MINUTES_OF_DAY + local.hour * 60 + local.minute


# --- times without notification -----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class QuietSpan:
    """A maintenance: a time in which nothing of a bus, or of all (None), is notified."""

    starts: UnixTime
    ends: UnixTime
    bus: str | None = None

    def covers(self, bus: str | None, at: UnixTime) -> bool:
        """Return whether an alarm of ``bus`` (None: of the site) is not notified at ``at``."""
        return self.bus in (None, bus) and self.starts <= at < self.ends


def recurring_spans(
    maintenance: MaintenanceSettings, first: date, last: date, zone: ZoneInfo
) -> Iterator[QuietSpan]:
    """Yield the spans of a recurring maintenance that begin on a day from ``first`` to ``last``, in order.
    Each lasts from the first moment at which the site's clock shows its start, or jumps over it, to the first
    moment at which the clock does so with its end. When the clocks change a span is shorter or longer; it is
    left out if its start and end are both skipped."""
    starts, ends = minute_of_day(maintenance.starts), minute_of_day(maintenance.ends)
    for number in range((min(last, maintenance.until) - first).days + 1):
        day = first + number * _DAY
        if DAYS[day.weekday()] in maintenance.days:
            begins = first_at(day, starts, zone)
            over_at = first_at(day + _DAY if ends <= starts else day, ends, zone)
            if begins < over_at:
                yield from (QuietSpan(begins, over_at, bus) for bus in maintenance.buses or (None,))


def first_at(day: date, minute: int, zone: ZoneInfo) -> UnixTime:
    """Return the first moment at which the clock shows a minute of a day; if the clocks skip that minute, the
    moment at which they go on."""
    local = datetime.combine(day, time()) + minute * _MINUTE
    while True:
        at = local.replace(tzinfo=zone).timestamp()
        if datetime.fromtimestamp(at, zone).replace(tzinfo=None) == local:
            return UnixTime(at)
        local += _MINUTE


# --- the alarms to notify ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Episode:
    """A time in which an alarm waits for its acknowledgement; ``entry``: the transition that began it."""

    alarm: str
    entry: int
    occurrence: int
    bus: str | None
    priority: AlarmPriority
    at: UnixTime
    notified_after_s: float = -1.0
    """The longest ``after_s`` of a rule that has been followed."""


@dataclass(frozen=True, slots=True)
class NotificationRule:
    """A rule that notifies a roster of addresses. ``buses``: empty for all; ``after_s``: seconds after which
    alarms that are not acknowledged are notified."""

    priorities: Sequence[AlarmPriority]
    buses: Sequence[str]
    after_s: float
    roster: DutyRoster

    def concerns(self, episode: Episode) -> bool:
        """Return whether the rule notifies alarms of this episode's priority and place."""
        is_there = not self.buses or (episode.bus is not None and episode.bus in self.buses)
        return is_there and episode.priority in self.priorities


@dataclass(frozen=True, slots=True)
class PlannedNotice:
    """A notice that is due: to one address, about one episode, by the rules of one ``after_s``."""

    episode: Episode
    after_s: float
    endpoint: str


@dataclass(slots=True)
class Followed:
    """The result of following transitions and the time. ``cleared``: transitions whose all-clear goes to the
    addresses that were notified of the occurrence."""

    open: dict[str, Episode]
    notices: list[PlannedNotice] = field(default_factory=list)
    cleared: list[JournalEntry] = field(default_factory=list)


def follow(
    episodes: Mapping[str, Episode],
    entries: Iterable[JournalEntry],
    rules: Sequence[NotificationRule],
    quiet: Sequence[QuietSpan],
    now: UnixTime,
    local: datetime,
) -> Followed:
    """Follow transitions, in order, and then the notices that are due by ``now``. If the clock was set back
    since an episode began, its time counts from ``now`` on."""
    done = Followed({key: replace(each, at=min(each.at, now)) for key, each in episodes.items()})

    def follow_rules(alarm: str) -> None:
        done.open[alarm], notices = due(done.open[alarm], rules, quiet, now, local)
        done.notices += notices

    for entry in entries:
        if _is_ended_by(entry):
            done.open.pop(entry.alarm, None)
        if entry.trigger == "clear":
            done.cleared.append(entry)
        episode = opened_by(entry)
        if episode is not None:
            done.open[entry.alarm] = episode
            if now - entry.at <= LATE_S:
                follow_rules(entry.alarm)
    for alarm in list(done.open):
        follow_rules(alarm)
    return done


def opened_by(entry: JournalEntry) -> Episode | None:
    """Return the episode that a transition begins; None if it begins none."""
    if entry.after not in UNACKNOWLEDGED or entry.trigger in ("clear", "silence"):
        return None
    return Episode(entry.alarm, entry.id, entry.occurrence, entry.bus, entry.priority, entry.at)


def _is_ended_by(entry: JournalEntry) -> bool:
    """Return whether a transition ends the episode of its alarm. A latched alarm still waits for its
    acknowledgement."""
    if entry.trigger == "clear":
        return entry.after != "latched_unack"
    return entry.after not in UNACKNOWLEDGED


def due(
    episode: Episode,
    rules: Iterable[NotificationRule],
    quiet: Sequence[QuietSpan],
    now: UnixTime,
    local: datetime,
) -> tuple[Episode, list[PlannedNotice]]:
    """Return the notices that are due and were not made before, and the episode, which remembers them."""
    concerned = [rule for rule in rules if rule.concerns(episode) and rule.after_s > episode.notified_after_s]
    due_now = [rule for rule in concerned if due_at(episode, rule.after_s, quiet) <= now]
    if not due_now:
        return episode, []
    first: dict[str, float] = {}
    for rule in sorted(due_now, key=lambda rule: rule.after_s):
        for endpoint in rule.roster.on_duty(local):
            first.setdefault(endpoint, rule.after_s)
    notices = [PlannedNotice(episode, after_s, endpoint) for endpoint, after_s in first.items()]
    return replace(episode, notified_after_s=max(rule.after_s for rule in due_now)), notices


def due_at(episode: Episode, after_s: float, quiet: Sequence[QuietSpan]) -> UnixTime:
    """Return the time at which rules of ``after_s`` apply; it counts from the end of a maintenance."""
    begins = _first_loud(episode, episode.at, quiet)
    return _first_loud(episode, begins + after_s, quiet)


def _first_loud(episode: Episode, at: UnixTime, quiet: Sequence[QuietSpan]) -> UnixTime:
    for span in sorted(quiet, key=lambda span: float(span.starts)):
        if span.covers(episode.bus, at):
            at = span.ends
    return at


# --- the next message of an address ---------------------------------------------------------------------


class NotDeliveredError(LinesideError):
    """Raised if a message was not delivered; it has the reason, without any secret."""


@dataclass(frozen=True, slots=True)
class Retry:
    """A delivery that is tried again at ``due``."""

    id: int
    attempts: int
    due: UnixTime

    def wait_s(self, now: UnixTime) -> float:
        """Return the seconds to wait. A wait that is longer than any backoff comes from a clock that was set
        back: it is 0."""
        wait_s = self.due - now
        return wait_s if 0 < wait_s <= MAX_RETRY_S else 0.0


@dataclass(frozen=True, slots=True)
class EndpointLoad:
    """The load of one address. ``items``: those in no message yet, oldest first, each with its time;
    ``sent``: the times of the last messages; ``standing``: items of alarms that stood at a start, which go in
    one message."""

    items: Sequence[tuple[int, UnixTime]]
    retries: Sequence[Retry]
    sent: Sequence[UnixTime]
    collects: bool = True
    """Whether several items may be one message: people read a digest, programs need each item."""
    standing: Sequence[int] = ()


@dataclass(frozen=True, slots=True)
class DeliveryTurn:
    """The next step for an address: ``items`` as one message, else the delivery ``retry``, else a wait."""

    items: tuple[int, ...] = ()
    retry: int | None = None
    wait_s: float | None = None
    """The seconds to wait; None: until there is a message to send."""


def next_turn(load: EndpointLoad, flood: int, digest_s: float, now: UnixTime) -> DeliveryTurn:
    """Return the next step for an address. New items go first: one refused message delays no other."""
    waits: list[float] = []
    if load.items:
        is_flood, (_, since) = _is_flooded(load, flood, now), load.items[0]
        # If the clock was set back since the wait began, the wait is over.
        wait_s = digest_s - (now - since) if is_flood and now >= since else 0.0
        if wait_s <= 0:
            return DeliveryTurn(items=tuple(item for item, _ in (load.items if is_flood else load.items[:1])))
        waits.append(wait_s)
    if load.standing:
        return DeliveryTurn(items=tuple(load.standing))
    due = [retry for retry in load.retries if not retry.wait_s(now)]
    if due:
        return DeliveryTurn(retry=min(due, key=lambda retry: (retry.attempts, retry.id)).id)
    waits += [retry.wait_s(now) for retry in load.retries]
    return DeliveryTurn(wait_s=min(waits, default=None))


def _is_flooded(load: EndpointLoad, flood: int, now: UnixTime) -> bool:
    """Return whether further items are collected: after many messages in ten minutes, or for an address that
    fails."""
    recent = [at for at in load.sent if 0 <= now - at < FLOOD_WINDOW_S]
    return load.collects and (len(recent) >= flood or bool(load.retries))


def retry_after_s(attempts: int) -> float:
    """Return the seconds up to the next attempt after ``attempts``: 5, 10, 20 …, at most 900."""
    return min(MAX_RETRY_S, FIRST_RETRY_S * 2.0 ** min(attempts - 1, 20))


def state_after_failure(created_at: UnixTime, now: UnixTime) -> DeliveryState:
    """Return the state of a message after a failure: it is given up after a day."""
    return "failed" if now - created_at >= GIVE_UP_S else "retrying"


def heartbeat_due(before: datetime, now: datetime, minute_of_day: int) -> str:
    """Return the day of the heartbeat (the daily proof that notification works) if its local time came after
    ``before``; else an empty text."""
    at = now.replace(hour=minute_of_day // 60, minute=minute_of_day % 60, second=0, microsecond=0)
    return now.date().isoformat() if before < at <= now else ""


EndpointKind = Literal["mail", "webhook", "apprise"]
ProgramSettings = WebhookSettings | AppriseSettings


@dataclass(frozen=True, slots=True)
class NotificationEndpoint:
    """An address that is notified. ``address``: as people may see it, without a URL, which may be secret."""

    kind: EndpointKind
    address: str
    settings: ProgramSettings | None = None

    @property
    def key(self) -> str:
        """The key of the address in the outbox, the same after a restart."""
        return f"{self.kind}:{self.address}"


class NotificationPlan:
    """Endpoints by key, rosters of keys by group, and rules. ``readers``: addresses that get reports; being a
    reader alone causes no other notice."""

    def __init__(self, settings: NotifySettings, readers: Iterable[str] = ()) -> None:
        self.settings = settings
        self.rosters = {group.name: _roster_of(group) for group in settings.group}
        smtp = settings.smtp
        mail = [_rule(smtp, _mail(smtp.to))] if smtp is not None and smtp.to else []
        programs = [*map(_program, settings.webhook), *map(_program, settings.apprise)]
        own = [_rule(each.settings, (each.key,)) for each in programs if each.settings is not None]
        of_groups = [
            NotificationRule(each.priorities, each.buses, each.after_s, self.rosters[each.group])
            for each in settings.rule
        ]
        self.rules = [*mail, *own, *of_groups]
        rosters = (*(rule.roster for rule in mail), *self.rosters.values())
        people = (key.removeprefix("mail:") for roster in rosters for key in roster.addresses())
        every = [*(NotificationEndpoint("mail", each) for each in (*people, *readers)), *programs]
        self.endpoints = {endpoint.key: endpoint for endpoint in every}

    def on_duty(self, group: str, local: datetime) -> list[str]:
        """Return the addresses of a group that are notified at a local time."""
        return [self.endpoints[key].address for key in self.rosters[group].on_duty(local)]

    def present(self, local: datetime) -> tuple[str, ...]:
        """Return the key of every address that any rule notifies at a local time."""
        return tuple(dict.fromkeys(key for rule in self.rules for key in rule.roster.on_duty(local)))

    def gaps(self, group: str) -> list[Message]:
        """Return each span of the week in which no one of a group is on duty."""
        return [
            Message.of(
                "notify_roster_gap",
                group=group,
                first_day=Message(f"day_{first // MINUTES_OF_DAY}"),
                first=clock_of(first),
                last_day=Message(f"day_{(end - 1) // MINUTES_OF_DAY}"),
                last=clock_of(end) if end % MINUTES_OF_DAY else "24:00",
            )
            for first, end in self.rosters[group].gaps()
        ]


def _rule(settings: SmtpSettings | ProgramSettings, keys: tuple[str, ...]) -> NotificationRule:
    """Return the rule for addresses that are notified at once and at any time."""
    buses = () if isinstance(settings, SmtpSettings) else settings.buses
    return NotificationRule(settings.priorities, buses, 0.0, DutyRoster(keys))


def _roster_of(group: GroupSettings) -> DutyRoster:
    periods = (
        DutyPeriod(
            frozenset(DAYS.index(day) for day in duty.days),
            minute_of_day(duty.starts),
            (minute_of_day(duty.ends) - minute_of_day(duty.starts) - 1) % MINUTES_OF_DAY + 1,
            _mail(duty.to),
        )
        for duty in group.duty
    )
    return DutyRoster(_mail(group.to), tuple(periods))


def _mail(addresses: Iterable[str]) -> tuple[str, ...]:
    return tuple(NotificationEndpoint("mail", address).key for address in addresses)


def _program(settings: ProgramSettings) -> NotificationEndpoint:
    """Return the endpoint of a program. Its address is the host or the name of the file, with a mark that
    distinguishes two of the same name."""
    url = settings.url if isinstance(settings, WebhookSettings) else None
    source = url or str(settings.url_file)
    name = urlsplit(url).hostname if url else settings.url_file and settings.url_file.name
    mark = blake2b(source.encode(), digest_size=3).hexdigest()
    kind: EndpointKind = "webhook" if isinstance(settings, WebhookSettings) else "apprise"
    return NotificationEndpoint(kind, f"{name}#{mark}", settings)
