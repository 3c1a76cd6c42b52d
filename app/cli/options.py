"""The options that several commands share: the configuration, and the bearer token of a dashboard."""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import click

from app.cli.process import complain
from app.errors import system_error
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message

CONFIG_VARIABLE = "LINESIDE_CONFIG"
INSTALLED_CONFIG = Path("/etc/lineside/lineside.toml")
"""The configuration of the installed service."""
NEW_CONFIG = Path("lineside.toml")
TOKEN_VARIABLE = "LINESIDE_TOKEN"
PATH = click.Path(path_type=Path)
ADDRESS = click.IntRange(1, 255)
TCP_PORT = click.IntRange(0, 65535)
MAX_TOKEN_BYTES = 4096


def default_config(environment: Mapping[str, str] = os.environ, of_service: Path = INSTALLED_CONFIG) -> Path:
    """Return the configuration of a command that names none: that of the environment, that of an installed
    service, else ``lineside.toml`` in this folder, which may be yet to be written."""
    if named := environment.get(CONFIG_VARIABLE):
        return Path(named)
    return of_service if is_installed(of_service) else NEW_CONFIG


def is_installed(of_service: Path) -> bool:
    """Return whether a service has its configuration there. If its folder is closed to this user it counts as
    installed: the user is then told so, instead of being given another file."""
    folder = of_service.parent
    return os.path.exists(of_service) or (folder.is_dir() and not os.access(folder, os.X_OK))  # noqa: PTH110


LINESIDE_TOML = default_config()
config_option = click.option(
    "--config",
    type=PATH,
    default=LINESIDE_TOML,
    help=f"The configuration; without it {CONFIG_VARIABLE}, {INSTALLED_CONFIG}, or lineside.toml here.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="The result as JSON.")
yes_option = click.option("--yes", is_flag=True, help="Skip the confirmation.")
url_option = click.option("--url", required=True, envvar="LINESIDE_URL", help="Address of the dashboard.")
bus_option = click.option("--bus", required=True, help="Name of the bus.")
token_option = click.option(
    "--token",
    default="",
    show_default=False,
    help=f"A bearer token. Other users of this machine can see it: use --token-file or {TOKEN_VARIABLE}.",
)
token_file_option = click.option(
    "--token-file", type=PATH, help="A file whose first line is the bearer token."
)


def bearer_token(token: str, file: Path | None, *more_variables: str, required: bool = True) -> str:
    """Return the token of ``--token``, ``--token-file``, or the environment (``LINESIDE_TOKEN`` or one of
    ``more_variables``), in this order; empty for none. A command line is visible to every user of the machine
    while it runs, a file and the environment are not. Raises CallerError for both options, for a file without
    a token, and for none if one is ``required``."""
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
            text = opened.read(MAX_TOKEN_BYTES).decode("ascii", errors="replace")
    except OSError as error:
        raise CallerError(
            Message.of("token_file_unreadable", file=str(file), error=system_error(error))
        ) from error
    lines = text.splitlines()
    if not lines or not lines[0].strip():
        raise CallerError(Message.of("token_file_empty", file=str(file)))
    return lines[0].strip()


def _warn_if_shared(file: Path, mode: int) -> None:
    """Warn of a file that other users can read. It is no error: a secret mounted by a container or a
    credential store is a regular file of any mode."""
    if stat.S_ISREG(mode) and mode & (stat.S_IRGRP | stat.S_IROTH):
        complain(Message.of("token_file_shared", file=str(file)))


def typed_time(text: str, zone: ZoneInfo, code: str) -> UnixTime:
    """Return a time as a person typed it, by the clock of the site unless it names another. Raises
    CallerError with the message of ``code`` for any other text."""
    try:
        typed = datetime.fromisoformat(text.strip())
        return UnixTime((typed if typed.tzinfo else typed.replace(tzinfo=zone)).timestamp())
    except (ValueError, OverflowError):
        raise CallerError(Message.of(code, text=text)) from None
