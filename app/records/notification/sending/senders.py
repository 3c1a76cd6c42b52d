"""Sends one message on the way that its address needs, within a bounded time."""

from __future__ import annotations

import asyncio
from contextlib import nullcontext
from typing import TYPE_CHECKING

import structlog

from app.records.notification.compose import Composer, hook_body
from app.records.notification.notice import Attachment, ReportAttachments, ReportNotice
from app.records.notification.outbox import NotificationDelivery
from app.records.notification.rules.delivery import NotDeliveredError
from app.records.notification.sending import programs
from app.records.notification.sending.endpoints import NotificationEndpoint
from app.records.notification.settings import AppriseSettings, SmtpSettings, WebhookSettings
from bus.errors import LinesideError
from bus.instants import UnixTime
from bus.messages import Message

if TYPE_CHECKING:
    from app.records.notification.sending.mail import MailServer

ATTEMPT_S = 30.0
"""For everything: name, connection, TLS, sign-in, message."""
MAIL_CONNECTIONS = 4
log = structlog.get_logger()


class Senders:
    """``smtp``: the mail server; None: there is none. ``reports``: makes the pages of reports; None: none is
    sent."""

    def __init__(
        self,
        smtp: SmtpSettings | None,
        composer: Composer,
        reports: ReportAttachments | None = None,
        attempt_s: float = ATTEMPT_S,
    ) -> None:
        self._server: MailServer | None = None
        if smtp is not None:
            from app.records.notification.sending.mail import (
                MailServer,  # most sites send no mail: it delays their start
            )

            self._server = MailServer(smtp)
        self._composer = composer
        self._reports = reports
        self._attempt_s = attempt_s
        self._mail = asyncio.Semaphore(MAIL_CONNECTIONS)

    async def send(
        self, endpoint: NotificationEndpoint, delivery: NotificationDelivery, now: UnixTime
    ) -> None:
        """Deliver. Raises NotDeliveredError; whether the message has arrived then is not known."""
        async with self._mail if endpoint.settings is None else nullcontext():
            try:
                async with asyncio.timeout(self._attempt_s):
                    await self._send(endpoint, delivery, now)
            except TimeoutError:
                seconds = round(self._attempt_s)
                raise NotDeliveredError(Message.of("notify_took_too_long", seconds=seconds)) from None
            except LinesideError as error:
                raise NotDeliveredError(error.message) from None
            except Exception as error:
                # Its text may hold a URL or a password.
                name = type(error).__name__
                log.error("a notification failed", error=name)
                raise NotDeliveredError(Message.of("notify_failed_unexpectedly", error=name)) from None

    async def _send(
        self, endpoint: NotificationEndpoint, delivery: NotificationDelivery, now: UnixTime
    ) -> None:
        match endpoint.settings:
            case WebhookSettings() as settings:
                await programs.post(settings, hook_body(self._composer.site, delivery, now), now)
            case AppriseSettings() as settings:
                await programs.notify_by_apprise(settings, self._composer.letter(delivery, now))
            case None:
                if self._server is None:
                    raise NotDeliveredError(Message("setting_mail_server_missing"))
                letter = self._composer.letter(delivery, now, await self._pages(delivery))
                await self._server.send(endpoint.address, letter)

    async def _pages(self, delivery: NotificationDelivery) -> list[Attachment]:
        notices = [item.notice for item in delivery.items if isinstance(item.notice, ReportNotice)]
        if not notices or self._reports is None:
            return []
        try:
            return [await self._reports.of(notice) for notice in notices]
        except LinesideError as error:
            raise NotDeliveredError(Message.of("notify_report_failed", reason=error.message)) from None
