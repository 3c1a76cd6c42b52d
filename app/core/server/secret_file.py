"""Reads passwords and keys from their files when they are needed, and keeps them nowhere."""

from __future__ import annotations

import os
from pathlib import Path

from app.errors import system_error
from bus.errors import LinesideError
from bus.messages import Message

MAX_BYTES = 4096


class SecretFileError(LinesideError):
    """Why a file of a secret cannot be used, without what is in it."""


def read_secret(path: Path) -> bytes:
    """Return the content of a file without its final newline. Raises SecretFileError."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        with os.fdopen(descriptor, "rb") as file:
            content = file.read(MAX_BYTES + 1) or b""
    except OSError as error:
        reason = system_error(error)
        raise SecretFileError(Message.of("notify_secret_unreadable", path=str(path), reason=reason)) from None
    secret = content.removesuffix(b"\n").removesuffix(b"\r")
    if not secret or len(content) > MAX_BYTES:
        raise SecretFileError(Message.of("notify_secret_empty", path=str(path), n=MAX_BYTES))
    return secret


def read_secret_text(path: Path) -> str:
    """Return the content of a file as one line of ASCII. Raises SecretFileError."""
    try:
        text = read_secret(path).decode("ascii").strip()
    except UnicodeDecodeError:
        text = ""
    if not text or not text.isprintable():
        raise SecretFileError(Message.of("notify_secret_not_text", path=str(path)))
    return text


def can_others_read(path: Path) -> bool:
    """Whether every user of the machine can read it."""
    try:
        return bool(path.stat().st_mode & 0o007)
    except OSError:
        return False
