"""Passwords and keys, read from their files when they are needed, and kept nowhere."""

from __future__ import annotations

import os
from pathlib import Path

from app.errors import system_error
from bus.errors import LinesideError
from bus.messages import Message

MAX_BYTES = 4096
MAIL_PASSWORD_VARIABLE = "LINESIDE_SMTP_PASSWORD"


class NotDeliveredError(LinesideError):
    """Why a message was not delivered, in words without any secret."""


def read_secret(path: Path) -> bytes:
    """Return the content of a file without its final newline. Raises NotDeliveredError."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        with os.fdopen(descriptor, "rb") as file:
            content = file.read(MAX_BYTES + 1) or b""
    except OSError as error:
        reason = system_error(error)
        raise NotDeliveredError(
            Message.of("notify_secret_unreadable", path=str(path), reason=reason)
        ) from None
    secret = content.removesuffix(b"\n").removesuffix(b"\r")
    if not secret or len(content) > MAX_BYTES:
        raise NotDeliveredError(Message.of("notify_secret_empty", path=str(path), n=MAX_BYTES))
    return secret


def read_secret_text(path: Path) -> str:
    """Return the content of a file as one line of ASCII. Raises NotDeliveredError."""
    try:
        text = read_secret(path).decode("ascii").strip()
    except UnicodeDecodeError:
        text = ""
    if not text or not text.isprintable():
        raise NotDeliveredError(Message.of("notify_secret_not_text", path=str(path)))
    return text


def mail_password(path: Path | None) -> str:
    """The password of the mail server: of its file, else of the environment. Raises NotDeliveredError."""
    if path is not None:
        return read_secret_text(path)
    password = os.environ.get(MAIL_PASSWORD_VARIABLE, "")
    if not password:
        raise NotDeliveredError(Message.of("notify_password_missing", variable=MAIL_PASSWORD_VARIABLE))
    return password


def can_others_read(path: Path) -> bool:
    """Whether every user of the machine can read it."""
    try:
        return bool(path.stat().st_mode & 0o007)
    except OSError:
        return False
