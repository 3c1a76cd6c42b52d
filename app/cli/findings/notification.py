"""Whether the path of notification that a configuration names works from this machine. Nothing is sent."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterator
from pathlib import Path

from app.cli.findings.machine import Finding
from app.notification.rules.delivery import NotDeliveredError
from app.notification.sending import programs
from app.notification.sending.endpoints import NotificationEndpoint, NotificationPlan
from app.notification.sending.mail import MailServer
from app.notification.settings import AppriseSettings, NotifySettings, WebhookSettings
from app.server.secret_file import can_others_read
from bus.errors import LinesideError
from bus.messages import Message

CHECK_S = 15.0


def notification_findings(settings: NotifySettings) -> Iterator[Finding]:
    """The mail server, each program, each roster, and the files of secrets."""
    plan = NotificationPlan(settings)
    for name in plan.rosters:
        yield from (Finding(message, is_fault=True) for message in plan.gaps(name))
    if plan.endpoints and settings.dashboard_url is None:
        yield Finding(Message("check_notify_no_links"))
    for path in _secret_files(settings):
        if can_others_read(path):
            yield Finding(Message.of("check_secret_open", path=str(path)))
    if settings.smtp is not None:
        place = f"{settings.smtp.host}:{settings.smtp.port}"
        reached = Message.of("check_notify_mail", address=place)
        yield _tried(place, MailServer(settings.smtp).test(), reached)
    for endpoint in plan.endpoints.values():
        if endpoint.settings is not None:
            reached = Message.of(f"check_notify_{endpoint.kind}", address=endpoint.address)
            yield _tried(endpoint.address, _reach(endpoint), reached)


async def _reach(endpoint: NotificationEndpoint) -> None:
    match endpoint.settings:
        case WebhookSettings() as settings:
            await programs.reach(settings)
        case AppriseSettings() as settings:
            programs.apprise_service(settings)


def _tried(address: str, attempt: Awaitable[None], reached: Message) -> Finding:
    try:
        asyncio.run(_bounded(attempt))
    except LinesideError as error:
        message = Message.of("check_notify_failed", address=address, reason=error.message)
        return Finding(message, is_fault=True)
    return Finding(reached)


async def _bounded(attempt: Awaitable[None]) -> None:
    try:
        async with asyncio.timeout(CHECK_S):
            await attempt
    except TimeoutError:
        raise NotDeliveredError(Message.of("notify_took_too_long", seconds=round(CHECK_S))) from None


def _secret_files(settings: NotifySettings) -> Iterator[Path]:
    smtp = settings.smtp
    found = [
        None if smtp is None else smtp.password_file,
        *(path for hook in settings.webhook for path in (hook.secret_file, hook.url_file)),
        *(each.url_file for each in settings.apprise),
    ]
    yield from (path for path in found if path is not None)
