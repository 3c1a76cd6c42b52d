"""The delivery of one message: as mail by SMTP with TLS, to a webhook by a signed POST, or by the package
apprise (the extra ``lineside[apprise]``). Each attempt takes a bounded time, and no error shows a secret."""

from __future__ import annotations

import asyncio
import hmac
import json
import os
import smtplib
import socket
import ssl
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from email.message import EmailMessage
from email.utils import format_datetime
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import structlog

from app.core.lifespan import in_thread
from app.core.server.settings import check_web_url, read_secret, read_secret_text
from app.errors import network_cause
from app.records.notification.compose import Composer, Letter, hook_body
from app.records.notification.outbox import (
    Attachment,
    NotificationDelivery,
    ReportAttachments,
    ReportNotice,
)
from app.records.notification.rules import NotDeliveredError, NotificationEndpoint
from app.records.notification.settings import AppriseSettings, SmtpSettings, WebhookSettings
from bus.errors import LinesideError
from bus.instants import UnixTime
from bus.messages import Message

ATTEMPT_S = 30.0
"""The seconds of one attempt: name, connection, TLS, sign-in and message."""
SOCKET_S = 10.0
MAIL_CONNECTIONS = 4
MAX_REASON_LENGTH = 300
MAIL_PASSWORD_VARIABLE = "LINESIDE_SMTP_PASSWORD"
SIGNATURE_HEADER = "Lineside-Signature"
DELIVERY_HEADER = "Lineside-Delivery"
log = structlog.get_logger()


class Senders:
    """The delivery to every kind of address. ``smtp`` None: no mail server is configured; ``reports``: makes
    the pages of reports."""

    def __init__(
        self, smtp: SmtpSettings | None, composer: Composer, reports: ReportAttachments | None = None
    ) -> None:
        self._smtp = smtp
        self._composer = composer
        self._reports = reports
        self._mail = asyncio.Semaphore(MAIL_CONNECTIONS)

    async def send(
        self, endpoint: NotificationEndpoint, delivery: NotificationDelivery, now: UnixTime
    ) -> None:
        """Deliver a message. Raise NotDeliveredError; the message may have arrived nevertheless."""
        async with self._mail if endpoint.settings is None else nullcontext():
            try:
                async with asyncio.timeout(ATTEMPT_S):
                    await self._send(endpoint, delivery, now)
            except TimeoutError:
                raise NotDeliveredError(
                    Message.of("notify_took_too_long", seconds=round(ATTEMPT_S))
                ) from None
            except LinesideError as error:
                raise NotDeliveredError(error.message) from None
            except Exception as error:
                # The text of the error may contain a URL or a password.
                name = type(error).__name__
                log.error("a notification failed", error=name)
                raise NotDeliveredError(Message.of("notify_failed_unexpectedly", error=name)) from None

    async def _send(
        self, endpoint: NotificationEndpoint, delivery: NotificationDelivery, now: UnixTime
    ) -> None:
        match endpoint.settings:
            case WebhookSettings() as settings:
                await post_hook(settings, hook_body(self._composer.site, delivery, now), now)
            case AppriseSettings() as settings:
                await notify_by_apprise(settings, self._composer.letter(delivery, now))
            case None:
                if self._smtp is None:
                    raise NotDeliveredError(Message("setting_mail_server_missing"))
                letter = self._composer.letter(delivery, now, await self._pages(delivery))
                await send_mail(self._smtp, endpoint.address, letter)

    async def _pages(self, delivery: NotificationDelivery) -> list[Attachment]:
        notices = [item.notice for item in delivery.items if isinstance(item.notice, ReportNotice)]
        if not notices or self._reports is None:
            return []
        try:
            return [await self._reports.make(notice) for notice in notices]
        except LinesideError as error:
            raise NotDeliveredError(Message.of("notify_report_failed", reason=error.message)) from None


# --- mail ---------------------------------------------------------------------------------------------


async def send_mail(settings: SmtpSettings, to: str, letter: Letter) -> None:
    """Deliver a letter to the mail server. A server without the configured encryption gets neither letter nor
    password. Raise LinesideError."""
    sender = settings.sender
    message = _mail_message(sender, to, letter)
    await _with_mail_server(
        settings, lambda server: server.send_message(message, from_addr=sender, to_addrs=[to])
    )


async def reach_mail_server(settings: SmtpSettings) -> None:
    """Connect, encrypt and sign in, but send nothing. Raise LinesideError."""
    await _with_mail_server(settings, lambda _: None)


async def _with_mail_server(settings: SmtpSettings, work: Callable[[smtplib.SMTP], object]) -> None:
    connected: list[smtplib.SMTP] = []

    def run() -> None:
        try:
            server = _connected(settings)
            connected.append(server)
            try:
                _secure(server, settings)
                work(server)
                with suppress(smtplib.SMTPException, OSError):
                    server.quit()
            finally:
                server.close()
        except (smtplib.SMTPException, OSError) as error:
            # smtplib reports a read that timed out as a closed connection.
            cause = error.__context__ if isinstance(error.__context__, TimeoutError) else error
            raise NotDeliveredError(_reason(settings, cause)) from None

    def stop() -> None:
        """Make every wait of the thread for the server fail at once."""
        for server in connected:
            if server.sock is not None:
                with suppress(OSError):
                    server.sock.shutdown(socket.SHUT_RDWR)

    await in_thread(run, stop=stop)


def _context(settings: SmtpSettings) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=settings.ca_file)


def _connected(settings: SmtpSettings) -> smtplib.SMTP:
    name, host, port = settings.sender.partition("@")[2], settings.host, settings.port
    if settings.security == "tls":
        return smtplib.SMTP_SSL(host, port, name, timeout=SOCKET_S, context=_context(settings))
    return smtplib.SMTP(host, port, name, timeout=SOCKET_S)


def _secure(server: smtplib.SMTP, settings: SmtpSettings) -> None:
    server.ehlo()
    if settings.security == "starttls":
        if not server.has_extn("starttls"):
            raise NotDeliveredError(
                Message.of("notify_mail_without_tls", host=settings.host, port=settings.port)
            )
        server.starttls(context=_context(settings))
        server.ehlo()
    if settings.user:
        server.login(settings.user, _password(settings.password_file))


def _password(path: Path | None) -> str:
    if path is not None:
        return read_secret_text(path)
    password = os.environ.get(MAIL_PASSWORD_VARIABLE, "")
    if not password:
        raise NotDeliveredError(Message.of("notify_password_missing", variable=MAIL_PASSWORD_VARIABLE))
    return password


def _mail_message(sender: str, to: str, letter: Letter) -> EmailMessage:
    """Return the mail of a letter. Raise ValueError for a header with a line break, which the policy refuses:
    the texts of a letter have one line."""
    # The parser of headers takes half a MiB, and few servers send mail.
    from email.policy import SMTP

    message = EmailMessage(policy=SMTP)
    message["From"] = sender
    message["To"] = to
    message["Subject"] = letter.subject
    message["Date"] = format_datetime(letter.at)
    message["Message-ID"] = f"<{letter.id}@{sender.partition('@')[2]}>"
    message["Auto-Submitted"] = "auto-generated"
    message["X-Lineside-Delivery"] = letter.id
    if letter.is_urgent:
        message["Importance"] = "high"
    message.set_content(letter.body)
    for page in letter.pages:
        message.add_attachment(page.page, subtype="html", filename=page.name)
    return message


def _reply(error: smtplib.SMTPResponseException) -> str:
    return _shown(error.smtp_code, error.smtp_error)


_FAULTS: tuple[tuple[type[Exception], str, Callable[[Any], str]], ...] = (
    (ssl.SSLCertVerificationError, "notify_certificate_untrusted", lambda error: error.verify_message),
    (ssl.SSLError, "notify_tls_failed", lambda error: error.reason or ""),
    (smtplib.SMTPNotSupportedError, "notify_mail_without_sign_in", lambda _: ""),
    (smtplib.SMTPAuthenticationError, "notify_mail_sign_in_refused", _reply),
    (
        smtplib.SMTPRecipientsRefused,
        "notify_mail_refused",
        lambda error: _shown(*next(iter(error.recipients.values()))),
    ),
    (smtplib.SMTPResponseException, "notify_mail_refused", _reply),
    (smtplib.SMTPServerDisconnected, "notify_disconnected", lambda _: ""),
    (TimeoutError, "notify_timed_out", lambda _: ""),
    (socket.gaierror, "notify_host_unknown", lambda _: ""),
    (OSError, "notify_not_connected", lambda error: error.strerror or ""),
)
"""The message of each kind of error; the first kind that fits counts."""


def _reason(settings: SmtpSettings, error: Exception) -> Message:
    code, reason = next(
        ((code, reason(error)) for kind, code, reason in _FAULTS if isinstance(error, kind)),
        ("notify_disconnected", ""),
    )
    return Message.of(code, host=settings.host, port=settings.port, reason=reason)


def _shown(code: int, text: bytes | str) -> str:
    """Return the reply of a server, which may contain any bytes, on one line."""
    words = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    line = " ".join("".join(sign if sign.isprintable() else " " for sign in words).split())
    return f"{code} {line}"[:MAX_REASON_LENGTH]


# --- webhooks and apprise -----------------------------------------------------------------------------


async def post_hook(settings: WebhookSettings, body: Mapping[str, Any], now: UnixTime) -> None:
    """Deliver one notice; ``body["id"]`` lets the receiver drop a duplicate. Raise LinesideError."""
    content = json.dumps(body, ensure_ascii=False, separators=(",", ":")).encode()
    headers = {
        "Content-Type": "application/json",
        SIGNATURE_HEADER: _signature(read_secret(settings.secret_file), content, int(float(now))),
        DELIVERY_HEADER: str(body["id"]),
    }
    status = await _exchange(settings, "POST", headers, content)
    if not 200 <= status < 300:
        raise NotDeliveredError(_refusal(settings, status))


async def reach_hook(settings: WebhookSettings) -> None:
    """Get a response of a webhook's server; nothing is notified. Raise LinesideError."""
    read_secret(settings.secret_file)
    status = await _exchange(settings, "HEAD", {}, b"")
    if 300 <= status < 400:
        raise NotDeliveredError(_refusal(settings, status))


def _signature(secret: bytes, body: bytes, at: int) -> str:
    """Return ``t=<unix seconds>,v1=<hex>``: HMAC-SHA256 of the time, a full stop and the body."""
    return f"t={at},v1={hmac.new(secret, b'%d.' % at + body, 'sha256').hexdigest()}"


async def _exchange(
    settings: WebhookSettings, method: str, headers: Mapping[str, str], content: bytes
) -> int:
    """Return the status of the response; its body, which may be too large, is not read."""
    import httpx  # a tenth of a second of the start

    url = _url_of(settings)
    place = _place(url)
    try:
        # No proxy and no password from the environment: they lead out of the plant.
        context = ssl.create_default_context(cafile=settings.ca_file)
        client = httpx.AsyncClient(verify=context, trust_env=False, timeout=SOCKET_S)
        sent = {"User-Agent": "lineside", **headers}
        async with (
            client,
            client.stream(method, url, headers=sent, content=content, follow_redirects=False) as response,
        ):
            return response.status_code
    except httpx.TimeoutException:
        raise NotDeliveredError(Message.of("notify_timed_out", **place)) from None
    except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
        raise NotDeliveredError(
            Message.of("notify_not_connected", **place, reason=network_cause(error))
        ) from None


def _url_of(settings: WebhookSettings) -> str:
    if settings.url is not None:
        return settings.url
    assert settings.url_file is not None
    try:
        return check_web_url(read_secret_text(settings.url_file))
    except ValueError:
        raise NotDeliveredError(Message.of("notify_secret_not_url", path=str(settings.url_file))) from None


def _place(url: str) -> dict[str, Any]:
    """Return host and port of a URL; the rest may be a secret."""
    parts = urlsplit(url)
    return {"host": parts.hostname or "", "port": parts.port or (443 if parts.scheme == "https" else 80)}


def _refusal(settings: WebhookSettings, status: int) -> Message:
    code = "notify_redirected" if 300 <= status < 400 else "notify_http_refused"
    return Message.of(code, **_place(_url_of(settings)), status=status)


async def notify_by_apprise(settings: AppriseSettings, letter: Letter) -> None:
    """Deliver a letter. Raise LinesideError without the reason, which apprise does not give."""

    def send() -> bool:
        return bool(apprise_service(settings).notify(title=letter.subject, body=letter.body))

    # The thread also imports the package, which takes up to a tenth of a second.
    if not await in_thread(send):
        raise NotDeliveredError(Message.of("notify_apprise_refused", name=settings.url_file.name))


def apprise_service(settings: AppriseSettings) -> Any:
    """Return the service of the URL. Raise LinesideError."""
    try:
        package = import_module("apprise")
    except ImportError:
        raise NotDeliveredError(Message("notify_apprise_missing")) from None
    service = package.Apprise()
    if not service.add(read_secret_text(settings.url_file)):
        raise NotDeliveredError(Message.of("notify_apprise_url", path=str(settings.url_file)))
    return service
