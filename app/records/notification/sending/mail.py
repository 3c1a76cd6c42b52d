"""E-mail: one connection for each message, by SMTP with TLS."""

from __future__ import annotations

import os
import smtplib
import socket
import ssl
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from email.message import EmailMessage
from email.policy import SMTP as SMTP_POLICY
from email.utils import format_datetime
from pathlib import Path
from typing import Any

from app.core.server.in_thread import in_thread
from app.core.server.settings import read_secret_text
from app.records.notification.compose import Letter
from app.records.notification.rules.delivery import NotDeliveredError
from app.records.notification.settings import SmtpSettings
from bus.messages import Message

SOCKET_S = 10.0
MAX_REASON_LENGTH = 300
MAIL_PASSWORD_VARIABLE = "LINESIDE_SMTP_PASSWORD"


class MailServer:
    """Sends messages. A server without the configured encryption gets neither message nor password."""

    def __init__(self, settings: SmtpSettings) -> None:
        self._settings = settings

    async def send(self, to: str, letter: Letter) -> None:
        """Deliver to the mail server. Raises LinesideError."""
        sender = self._settings.sender
        message = _message(sender, to, letter)
        await self._run(lambda server: server.send_message(message, from_addr=sender, to_addrs=[to]))

    async def test(self) -> None:
        """Connect, encrypt and sign in; nothing is sent. Raises LinesideError."""
        await self._run(lambda _: None)

    async def _run(self, work: Callable[[smtplib.SMTP], object]) -> None:
        connection = _Connection(self._settings)
        await in_thread(lambda: connection.run(work), stop=connection.end)


@dataclass(slots=True)
class _Connection:
    """One connection, used by one thread. Another may end what it waits for."""

    settings: SmtpSettings
    _server: smtplib.SMTP | None = None

    def run(self, work: Callable[[smtplib.SMTP], object]) -> None:
        try:
            self._server = server = _connected(self.settings)
            try:
                _secure(server, self.settings)
                work(server)
                with suppress(smtplib.SMTPException, OSError):
                    server.quit()
            finally:
                server.close()
        except (smtplib.SMTPException, OSError) as error:
            # smtplib reports a read that timed out as a connection that was closed.
            cause = error.__context__ if isinstance(error.__context__, TimeoutError) else error
            raise NotDeliveredError(_reason(self.settings, cause)) from None

    def end(self) -> None:
        """Make every wait for the server fail at once."""
        sock = None if self._server is None else self._server.sock
        if sock is not None:
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)


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
    """Return the password of the file, else of the environment. Raises LinesideError."""
    if path is not None:
        return read_secret_text(path)
    password = os.environ.get(MAIL_PASSWORD_VARIABLE, "")
    if not password:
        raise NotDeliveredError(Message.of("notify_password_missing", variable=MAIL_PASSWORD_VARIABLE))
    return password


def _message(sender: str, to: str, letter: Letter) -> EmailMessage:
    """The policy refuses a header with a line break; texts have none, as they are made of one line."""
    message = EmailMessage(policy=SMTP_POLICY)
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
"""The first that fits: each is a case of one further down, or of none."""


def _reason(settings: SmtpSettings, error: Exception) -> Message:
    code, reason = next(
        ((code, reason(error)) for kind, code, reason in _FAULTS if isinstance(error, kind)),
        ("notify_disconnected", ""),
    )
    return Message.of(code, host=settings.host, port=settings.port, reason=reason)


def _shown(code: int, text: bytes | str) -> str:
    """What the server replied, on one line: it may hold any bytes."""
    words = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    line = " ".join("".join(sign if sign.isprintable() else " " for sign in words).split())
    return f"{code} {line}"[:MAX_REASON_LENGTH]
