"""What of an alarm is notified, to whom and when. Pure: transitions, rules and the time in."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

from app.line.alarms.journal import JournalEntry
from app.line.alarms.rules.state_machine import AlarmState
from app.line.conditions.condition import AlarmPriority
from app.records.notification.rules.roster import DutyRoster
from bus.instants import UnixTime

UNACKNOWLEDGED: frozenset[AlarmState] = frozenset(("unack_active", "rtn_unack", "latched_unack"))
LATE_S = 3600.0
"""An alarm that came and went longer ago is not notified: the server was off meanwhile."""


@dataclass(frozen=True, slots=True)
class NotificationRule:
    """``buses``: empty for all; ``after_s``: while not acknowledged by then; ``roster``: of endpoints."""

    priorities: Sequence[AlarmPriority]
    buses: Sequence[str]
    after_s: float
    roster: DutyRoster

    def concerns(self, episode: Episode) -> bool:
        """Whether an alarm of this priority and place is notified."""
        is_there = not self.buses or (episode.bus is not None and episode.bus in self.buses)
        return is_there and episode.priority in self.priorities


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
class QuietSpan:
    """Maintenance: of one bus, or of all that there is."""

    starts: UnixTime
    ends: UnixTime
    bus: str | None = None

    def covers(self, bus: str | None, at: UnixTime) -> bool:
        """Whether an alarm of ``bus`` (None: of the site) is not notified at ``at``."""
        return self.bus in (None, bus) and self.starts <= at < self.ends


@dataclass(frozen=True, slots=True)
class PlannedNotice:
    """One address is to be notified of one episode by the rules of one ``after_s``."""

    episode: Episode
    after_s: float
    endpoint: str


def opened_by(entry: JournalEntry) -> Episode | None:
    """The episode that a transition begins; None where it begins none."""
    if entry.after not in UNACKNOWLEDGED or entry.trigger in ("clear", "silence"):
        return None
    return Episode(entry.alarm, entry.id, entry.occurrence, entry.bus, entry.priority, entry.at)


def is_ended_by(entry: JournalEntry) -> bool:
    """Whether a transition ends the episode of its alarm. A latched alarm waits for its acknowledgement."""
    if entry.trigger == "clear":
        return entry.after != "latched_unack"
    return entry.after not in UNACKNOWLEDGED


def due_at(episode: Episode, after_s: float, quiet: Sequence[QuietSpan]) -> UnixTime:
    """When rules of ``after_s`` are followed. The time counts from the end of a maintenance on."""
    begins = _first_loud(episode, episode.at, quiet)
    return _first_loud(episode, begins + after_s, quiet)


def _first_loud(episode: Episode, at: UnixTime, quiet: Sequence[QuietSpan]) -> UnixTime:
    for span in sorted(quiet, key=lambda span: float(span.starts)):
        if span.covers(episode.bus, at):
            at = span.ends
    return at


def due(
    episode: Episode,
    rules: Iterable[NotificationRule],
    quiet: Sequence[QuietSpan],
    now: UnixTime,
    local: datetime,
) -> tuple[Episode, list[PlannedNotice]]:
    """The notices that are due and were not made before; and the episode, which remembers it."""
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


@dataclass(slots=True)
class Followed:
    """What transitions and the time have led to. ``cleared``: their all-clear goes to those who were
    notified of the occurrence."""

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
    """Take in transitions, in order, and then what is due by ``now``. Where the clock was set back since an
    episode began, its time counts from ``now`` on."""
    done = Followed({key: replace(each, at=min(each.at, now)) for key, each in episodes.items()})
    for entry in entries:
        if is_ended_by(entry):
            done.open.pop(entry.alarm, None)
        if entry.trigger == "clear":
            done.cleared.append(entry)
        episode = opened_by(entry)
        if episode is not None:
            done.open[entry.alarm] = episode
            if now - entry.at <= LATE_S:
                _follow_rules(done, entry.alarm, rules, quiet, now, local)
    for alarm in list(done.open):
        _follow_rules(done, alarm, rules, quiet, now, local)
    return done


def _follow_rules(
    done: Followed,
    alarm: str,
    rules: Sequence[NotificationRule],
    quiet: Sequence[QuietSpan],
    now: UnixTime,
    local: datetime,
) -> None:
    done.open[alarm], notices = due(done.open[alarm], rules, quiet, now, local)
    done.notices += notices
