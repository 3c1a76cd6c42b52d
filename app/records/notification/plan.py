"""The addresses and rules of notification, from the configuration."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from hashlib import blake2b
from typing import Literal
from urllib.parse import urlsplit

from app.records.notification.rules import MINUTES_OF_DAY, DutyPeriod, DutyRoster, NotificationRule
from app.records.notification.settings import (
    DAYS,
    AppriseSettings,
    GroupSettings,
    NotifySettings,
    SmtpSettings,
    WebhookSettings,
    clock_of,
    minute_of_day,
)
from bus.messages import Message

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
