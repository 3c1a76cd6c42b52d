"""The settings of notification: people, alarms and ways (``[notify]`` of lineside.toml)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from datetime import date
from hashlib import blake2b
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field, field_serializer, model_validator

from app.core.server.settings import WebUrl
from bus.messages import Message
from bus.settings import BusSettings, StrictModel
from bus.validation import OneLine, setting_fault

NotifiedPriority = Literal["urgent", "high", "medium", "low"]
DayOfWeek = Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]
MailSecurity = Literal["starttls", "tls", "none"]
DAYS: tuple[DayOfWeek, ...] = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
_MAIL = re.compile(r"[A-Za-z0-9!#$%&'*+/=?^_`{|}~.-]{1,64}@[A-Za-z0-9](?:[A-Za-z0-9._-]{0,252}[A-Za-z0-9])?")
_CLOCK = re.compile(r"(?:[01][0-9]|2[0-3]):[0-5][0-9]")


def _mail_address(written: str) -> str:
    if not _MAIL.fullmatch(written):
        raise ValueError(Message("setting_mail_address"))
    return written


def _clock_time(written: str) -> str:
    if not _CLOCK.fullmatch(written):
        raise ValueError(Message("setting_clock_time"))
    return written


def _calendar_day(written: object) -> object:
    if type(written) is not date:
        raise ValueError(Message("setting_day"))
    return written


CalendarDay = Annotated[date, BeforeValidator(_calendar_day)]
MailAddress = Annotated[str, AfterValidator(_mail_address)]
ClockTime = Annotated[str, AfterValidator(_clock_time)]
Addresses = Annotated[tuple[MailAddress, ...], Field(max_length=50)]
Priorities = Annotated[tuple[NotifiedPriority, ...], Field(min_length=1)]
BusNames = tuple[str, ...]
GroupName = Annotated[OneLine, Field(min_length=1, max_length=40)]
DEFAULT_PRIORITIES: tuple[NotifiedPriority, ...] = ("urgent", "high")


def minute_of_day(clock: str) -> int:
    """Return the minute of the day: ``06:30`` → 390."""
    hours, minutes = clock.split(":")
    return 60 * int(hours) + int(minutes)


def clock_of(minute: int) -> str:
    """Return the time of a minute of the day or the week: 390 → ``06:30``."""
    hours, minutes = divmod(minute % (24 * 60), 60)
    return f"{hours:02}:{minutes:02}"


class SmtpSettings(StrictModel):
    """The mail server. ``to``: notified of ``priorities`` at once and at any time."""

    host: Annotated[str, Field(min_length=1, max_length=253, pattern=r"^[A-Za-z0-9.:_-]+$")]
    port: Annotated[int, Field(strict=True, ge=1, le=65535)] = 587
    security: MailSecurity = "starttls"
    sender: MailAddress
    user: Annotated[OneLine, Field(max_length=200)] = ""
    password_file: Path | None = None
    ca_file: Path | None = None
    """The certificate authorities to trust instead of those of the machine."""
    to: Addresses = ()
    priorities: Priorities = DEFAULT_PRIORITIES

    @model_validator(mode="after")
    def _password_is_not_sent_in_the_clear(self) -> SmtpSettings:
        if self.user and self.security == "none":
            raise setting_fault(Message("setting_mail_password_open"), "security")
        return self


class WebhookSettings(StrictModel):
    """A program that is notified of ``priorities``. A file has its URL if that is a secret."""

    url: WebUrl | None = None
    url_file: Path | None = None
    secret_file: Path
    ca_file: Path | None = None
    priorities: Priorities = DEFAULT_PRIORITIES
    buses: BusNames = ()
    """Empty: all buses, and the server's own alarms."""

    @field_serializer("url")
    def _without_its_path(self, url: str | None) -> str | None:
        """Return the host and a digest for a support bundle: the URL may be a secret, but a change of it must
        show."""
        return url and f"{urlsplit(url).hostname}#{blake2b(url.encode(), digest_size=8).hexdigest()}"

    @model_validator(mode="after")
    def _has_one_url(self) -> WebhookSettings:
        if (self.url is None) == (self.url_file is None):
            raise setting_fault(Message("setting_webhook_url"))
        return self


class AppriseSettings(StrictModel):
    """A service that the package apprise reaches. The file has its URL, which contains its password."""

    url_file: Path
    priorities: Priorities = DEFAULT_PRIORITIES
    buses: BusNames = ()


class DutySettings(StrictModel):
    """A time of duty: people, days and hours. If ``ends`` is not after ``starts``, it is on the next day."""

    days: Annotated[tuple[DayOfWeek, ...], Field(min_length=1)] = DAYS
    starts: ClockTime
    ends: ClockTime
    to: Annotated[Addresses, Field(min_length=1)]


class GroupSettings(StrictModel):
    """A group of people who are notified together. ``to``: at any time; ``duty``: by roster."""

    name: GroupName
    to: Addresses = ()
    duty: Annotated[tuple[DutySettings, ...], Field(max_length=200)] = ()

    @model_validator(mode="after")
    def _has_people(self) -> GroupSettings:
        if not self.to and not self.duty:
            raise setting_fault(Message.of("setting_group_empty", name=self.name))
        return self


class RuleSettings(StrictModel):
    """The alarms of which a group is notified; ``after_s``: only those not acknowledged by then."""

    group: GroupName
    priorities: Priorities = DEFAULT_PRIORITIES
    buses: BusNames = ()
    after_s: Annotated[float, Field(strict=True, ge=0, le=86_400)] = 0.0


class MaintenanceSettings(StrictModel):
    """A recurring time without notification. If ``ends`` is not after ``starts``, it is on the next day."""

    days: Annotated[tuple[DayOfWeek, ...], Field(min_length=1)] = DAYS
    starts: ClockTime
    ends: ClockTime
    until: CalendarDay
    """The last day on which the maintenance begins: silence must end some day."""
    reason: Annotated[OneLine, Field(min_length=1, max_length=200)]
    buses: BusNames = ()
    """Empty: all buses, and the server's own alarms."""


class NotifySettings(StrictModel):
    """The settings of notification. Without any address nothing is sent."""

    dashboard_url: WebUrl | None = None
    """The address of the dashboard for people; without it a message has no link."""
    heartbeat_at: ClockTime = "07:00"
    """The local time at which each address gets the daily proof that notification works."""
    flood: Annotated[int, Field(strict=True, ge=1, le=1000)] = 10
    """The messages to one address in ten minutes after which further alarms are collected."""
    digest_s: Annotated[float, Field(strict=True, ge=5, le=3600)] = 60.0
    """The seconds between messages of collected alarms."""
    smtp: SmtpSettings | None = None
    webhook: Annotated[tuple[WebhookSettings, ...], Field(max_length=20)] = ()
    apprise: Annotated[tuple[AppriseSettings, ...], Field(max_length=20)] = ()
    group: Annotated[tuple[GroupSettings, ...], Field(max_length=50)] = ()
    rule: Annotated[tuple[RuleSettings, ...], Field(max_length=100)] = ()
    maintenance: Annotated[tuple[MaintenanceSettings, ...], Field(max_length=20)] = ()

    @property
    def certificates(self) -> set[Path]:
        """The files of certificates that the settings name."""
        named = [None if self.smtp is None else self.smtp.ca_file, *(each.ca_file for each in self.webhook)]
        return {path for path in named if path is not None}


def refuse_unknown_names(notify: NotifySettings, buses: Iterable[BusSettings]) -> None:
    """Raise PydanticCustomError for a group or bus that is not configured, a group that is configured twice,
    and mail without a mail server."""
    for message, *at in _unknown_names(notify, {bus.name for bus in buses}):
        raise setting_fault(message, "notify", *at)


def _unknown_names(notify: NotifySettings, buses: set[str]) -> Iterator[tuple[Any, ...]]:
    groups = [group.name for group in notify.group]
    for index, name in enumerate(groups):
        if name in groups[:index]:
            yield Message.of("setting_group_twice", name=name), "group", index, "name"
    if notify.smtp is None and groups:
        yield Message("setting_mail_server_missing"), "group", 0, "name"
    for index, rule in enumerate(notify.rule):
        if rule.group not in groups:
            yield Message.of("setting_rule_group", name=rule.group), "rule", index, "group"
    for key in ("webhook", "apprise", "rule", "maintenance"):
        for index, each in enumerate(getattr(notify, key)):
            for bus in each.buses:
                if bus not in buses:
                    yield Message.of("setting_notify_bus", bus=bus), key, index, "buses"
