"""The passwords and keys of notification, whose faults are reasons why a message was not delivered."""

from __future__ import annotations

import os
from pathlib import Path

from app.server import secret_file
from app.server.secret_file import SecretFileError
from bus.errors import LinesideError
from bus.messages import Message

MAIL_PASSWORD_VARIABLE = "LINESIDE_SMTP_PASSWORD"


class NotDeliveredError(LinesideError):
    """Why a message was not delivered, in words without any secret."""


def read_secret(path: Path) -> bytes:
    """Return the content of a file without its final newline. Raises NotDeliveredError."""
    try:
        return secret_file.read_secret(path)
    except SecretFileError as error:
        raise NotDeliveredError(error.message) from None


def read_secret_text(path: Path) -> str:
    """Return the content of a file as one line of ASCII. Raises NotDeliveredError."""
    try:
        return secret_file.read_secret_text(path)
    except SecretFileError as error:
        raise NotDeliveredError(error.message) from None


def mail_password(path: Path | None) -> str:
    """The password of the mail server: of its file, else of the environment. Raises NotDeliveredError."""
    if path is not None:
        return read_secret_text(path)
    password = os.environ.get(MAIL_PASSWORD_VARIABLE, "")
    if not password:
        raise NotDeliveredError(Message.of("notify_password_missing", variable=MAIL_PASSWORD_VARIABLE))
    return password
