"""The addresses and rules of the configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from hashlib import blake2b
from typing import Literal
from urllib.parse import urlsplit

from app.notification.rules.notices import NotificationRule
from app.notification.rules.roster import MINUTES_OF_DAY, DutyPeriod, DutyRoster
from app.notification.settings import (
    DAYS,
    AppriseSettings,
    GroupSettings,
    NotifiedPriority,
    NotifySettings,
    WebhookSettings,
    clock_of,
    minute_of_day,
)
from bus.messages import Message

EndpointKind = Literal["mail", "webhook", "apprise"]


@dataclass(frozen=True, slots=True)
class NotificationEndpoint:
    """``address``: as people may see it; a URL is not shown, as it may be a secret."""

    kind: EndpointKind
    address: str
    settings: WebhookSettings | AppriseSettings | None = None

    @property
    def key(self) -> str:
        """Identifies it in the outbox, also after a restart."""
        return f"{self.kind}:{self.address}"


def roster_of(group: GroupSettings) -> DutyRoster:
    """The duty roster of a group."""
    periods = (
        DutyPeriod(
            frozenset(DAYS.index(day) for day in duty.days),
            minute_of_day(duty.starts),
            (minute_of_day(duty.ends) - minute_of_day(duty.starts) - 1) % MINUTES_OF_DAY + 1,
            duty.to,
        )
        for duty in group.duty
    )
    return DutyRoster(group.to, tuple(periods))


class NotificationPlan:
    """The configuration: endpoints by key, rosters by group, and rules."""

    def __init__(self, settings: NotifySettings) -> None:
        self.settings = settings
        self.rosters = {group.name: roster_of(group) for group in settings.group}
        programs = [*map(_program, settings.webhook), *map(_program, settings.apprise)]
        mail = () if settings.smtp is None else settings.smtp.to
        people = dict.fromkeys((*mail, *(to for each in self.rosters.values() for to in each.addresses())))
        every = [*(NotificationEndpoint("mail", address) for address in people), *programs]
        self.endpoints = {endpoint.key: endpoint for endpoint in every}
        self.rules = list(self._rules(programs))

    def _rules(self, programs: Iterable[NotificationEndpoint]) -> Iterable[NotificationRule]:
        smtp = self.settings.smtp
        if smtp is not None and smtp.to:
            yield _rule(smtp.priorities, (), 0.0, _always(_mail(smtp.to)))
        for endpoint in programs:
            if endpoint.settings is not None:
                buses = endpoint.settings.buses
                yield _rule(endpoint.settings.priorities, buses, 0.0, _always((endpoint.key,)))
        for rule in self.settings.rule:
            yield _rule(rule.priorities, rule.buses, rule.after_s, _by_roster(self.rosters[rule.group]))

    def present(self, local: datetime) -> tuple[str, ...]:
        """Every address that some rule notifies at a local time."""
        return tuple(dict.fromkeys(key for rule in self.rules for key in rule.recipients(local)))

    def gaps(self, group: str) -> list[Message]:
        """Each span of the week in which no one of a group is on duty."""
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


def _rule(
    priorities: Iterable[NotifiedPriority],
    buses: Iterable[str],
    after_s: float,
    recipients: Callable[[datetime], tuple[str, ...]],
) -> NotificationRule:
    return NotificationRule(frozenset(priorities), frozenset(buses), after_s, recipients)


def _mail(addresses: Iterable[str]) -> tuple[str, ...]:
    return tuple(NotificationEndpoint("mail", address).key for address in addresses)


def _always(keys: tuple[str, ...]) -> Callable[[datetime], tuple[str, ...]]:
    return lambda _: keys


def _by_roster(roster: DutyRoster) -> Callable[[datetime], tuple[str, ...]]:
    return lambda local: _mail(roster.on_duty(local))


def _program(settings: WebhookSettings | AppriseSettings) -> NotificationEndpoint:
    """Its address is the host, or the name of the file, and a mark that distinguishes two of one name."""
    url = settings.url if isinstance(settings, WebhookSettings) else None
    source = url or str(settings.url_file)
    name = urlsplit(url).hostname if url else settings.url_file and settings.url_file.name
    mark = blake2b(source.encode(), digest_size=3).hexdigest()
    kind: EndpointKind = "webhook" if isinstance(settings, WebhookSettings) else "apprise"
    return NotificationEndpoint(kind, f"{name}#{mark}", settings)
