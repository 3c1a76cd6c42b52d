"""Sends one message on the way that its address needs, within a bounded time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable

import structlog

from app.alarms.notification import apprise_url, webhook
from app.alarms.notification.compose import Composer, hook_body
from app.alarms.notification.endpoints import NotificationEndpoint
from app.alarms.notification.mail import MailServer
from app.alarms.notification.outbox import NotificationDelivery
from app.alarms.notification.secret_file import NotDeliveredError
from app.notify_settings import AppriseSettings, SmtpSettings, WebhookSettings
from bus.instants import UnixTime
from bus.messages import Message

ATTEMPT_S = 30.0
"""For everything: name, connection, TLS, sign-in, message."""
MAIL_CONNECTIONS = 4
log = structlog.get_logger()


class Senders:
    """``smtp``: the mail server; None: there is none."""

    def __init__(self, smtp: SmtpSettings | None, composer: Composer, attempt_s: float = ATTEMPT_S) -> None:
        self._server = None if smtp is None else MailServer(smtp)
        self._composer = composer
        self._attempt_s = attempt_s
        self._mail = asyncio.Semaphore(MAIL_CONNECTIONS)

    async def send(
        self, endpoint: NotificationEndpoint, delivery: NotificationDelivery, now: UnixTime
    ) -> None:
        """Deliver. Raises NotDeliveredError; whether the message has arrived then is not known."""
        match endpoint.settings:
            case WebhookSettings() as settings:
                body = hook_body(self._composer.site, delivery, now)
                await self._bounded(webhook.post(settings, body, now))
            case AppriseSettings() as settings:
                await self._bounded(apprise_url.notify(settings, self._composer.letter(delivery, now)))
            case None:
                if self._server is None:
                    raise NotDeliveredError(Message("setting_mail_server_missing"))
                letter = self._composer.letter(delivery, now)
                async with self._mail:
                    await self._bounded(self._server.send(endpoint.address, letter))

    async def _bounded(self, sending: Awaitable[None]) -> None:
        try:
            async with asyncio.timeout(self._attempt_s):
                await sending
        except TimeoutError:
            raise NotDeliveredError(
                Message.of("notify_took_too_long", seconds=round(self._attempt_s))
            ) from None
        except NotDeliveredError:
            raise
        except Exception as error:
            log.error("a notification failed", error=type(error).__name__)
            raise NotDeliveredError(
                Message.of("notify_failed_unexpectedly", error=type(error).__name__)
            ) from None
