"""The bearer token of a command: as an option, from a file or from the environment.

A command line is visible to every user of the machine while the command runs; a file and the environment
are not.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from app.cli.ending import complain
from app.cli.options import TOKEN_VARIABLE
from app.errors import system_error
from bus.errors import CallerError
from bus.messages import Message

MAX_BYTES = 4096


def bearer_token(token: str, file: Path | None, *more_variables: str, required: bool = True) -> str:
    """The token by ``--token``, else ``--token-file``, else the environment: ``LINESIDE_TOKEN`` or one of
    ``more_variables``; empty for none. Raises CallerError for both options, for a file without a token, and
    for none where one is ``required``."""
    if token and file is not None:
        raise CallerError(Message("token_given_twice"))
    if file is not None:
        found = _token_in(file)
    else:
        values = [os.environ.get(name, "").strip() for name in (TOKEN_VARIABLE, *more_variables)]
        found = next(filter(None, (token, *values)), "")
    if not (found.isascii() and found.isprintable()) or " " in found:
        raise CallerError(Message("token_malformed"))
    if required and not found:
        raise CallerError(Message.of("token_not_given", variable=TOKEN_VARIABLE))
    return found


def _token_in(file: Path) -> str:
    try:
        with file.open("rb") as opened:
            _warn_if_shared(file, os.fstat(opened.fileno()).st_mode)
            text = opened.read(MAX_BYTES).decode("ascii", errors="replace")
    except OSError as error:
        raise CallerError(
            Message.of("token_file_unreadable", file=str(file), error=system_error(error))
        ) from error
    lines = text.splitlines()
    if not lines or not lines[0].strip():
        raise CallerError(Message.of("token_file_empty", file=str(file)))
    return lines[0].strip()


def _warn_if_shared(file: Path, mode: int) -> None:
    """A secret mounted by a container or a credential store is a regular file of any mode, and no mistake of
    the caller: this warns and goes on."""
    if stat.S_ISREG(mode) and mode & (stat.S_IRGRP | stat.S_IROTH):
        complain(Message.of("token_file_shared", file=str(file)))
