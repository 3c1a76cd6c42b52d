"""The shared parts of commands: options, exit codes (0 done, 1 failed, 2 wrong use), reports in English, the
rights of the process."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import click

from app.errors import system_error
from bus.errors import CallerError, LinesideError
from bus.instants import UnixTime
from bus.messages import Message, ParamValue

WRONG_CONFIGURATION = os.EX_CONFIG
"""The exit code of a service with a wrong configuration: another start would end the same way."""


@contextmanager
def ending() -> Iterator[None]:
    """Turn the errors of a command into one line and an exit code."""
    try:
        yield
    except CallerError as error:
        complain(error.message)
        raise click.exceptions.Exit(2) from error
    except LinesideError as error:
        complain(error.message)
        raise click.exceptions.Exit(1) from error
    except click.Abort:
        if sys.stdin.isatty():
            raise
        complain(Message("prompt_without_response"))
        raise click.exceptions.Exit(2) from None
    except BrokenPipeError:
        raise  # the reader of the output has gone: click ends without a message
    except OSError as error:
        complain(Message.of("system_error", error=str(error)))
        raise click.exceptions.Exit(1) from error


def wrong_option(option: str, code: str, **params: ParamValue) -> click.BadParameter:
    """Return the error for a wrong value of ``option`` (exit code 2), by its message code."""
    return click.BadParameter(str(Message(code, params)), param_hint=option)


def report(message: Message, *, err: bool = False) -> None:
    """Print a line to standard output or standard error."""
    click.echo(str(message), err=err)


def complain(reason: Message) -> None:
    """Print a line to standard error that begins with the program's name, as Unix tools do."""
    report(Message.of("command_failed", reason=reason), err=True)


def become_owner_of(folder: Path) -> None:
    """Become the owner of a folder, permanently, if root calls and the folder belongs to another user: the
    service keeps owning its files. A missing folder counts as owned by the owner of the folder in which it
    would be created."""
    if os.geteuid() != 0 or (owner := _owner(folder)) is None:
        return
    uid, gid = owner
    os.setgroups(_groups_of(uid, gid))
    os.setresgid(gid, gid, gid)
    os.setresuid(uid, uid, uid)


@contextmanager
def acting_as_owner_of(folder: Path) -> Iterator[None]:
    """Act as the owner of a folder in this context, as `become_owner_of` does permanently."""
    if os.geteuid() != 0 or (owner := _owner(folder)) is None:
        yield
        return
    (uid, gid), own_gid, own_groups = owner, os.getegid(), os.getgroups()
    os.setgroups(_groups_of(uid, gid))
    os.setegid(gid)
    os.seteuid(uid)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(own_gid)
        os.setgroups(own_groups)


def _owner(folder: Path) -> tuple[int, int] | None:
    """Return user and group of the folder, or of its nearest existing parent; None if that is root."""
    nearest = next((each for each in (folder, *folder.parents) if os.path.isdir(each)), None)  # noqa: PTH112
    if nearest is None:
        return None
    found = nearest.stat()
    return (found.st_uid, found.st_gid) if found.st_uid != 0 else None


def _groups_of(uid: int, gid: int) -> list[int]:
    """Return the groups of a user, such as that of the serial ports; a user without a name only has its own
    group."""
    # Imported only here, for root; other commands do without the module.
    import pwd

    try:
        return os.getgrouplist(pwd.getpwuid(uid).pw_name, gid)
    except KeyError:
        return [gid]


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
    """Return the configuration for a command that names none: that of the environment, else of an installed
    service, else ``lineside.toml`` in this folder, which need not exist yet."""
    if named := environment.get(CONFIG_VARIABLE):
        return Path(named)
    return of_service if is_installed(of_service) else NEW_CONFIG


def is_installed(of_service: Path) -> bool:
    """Return whether a service has its configuration there. A folder that is closed to this user counts as
    installed: the user is told so, instead of getting another file."""
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
    ``more_variables``), in this order; empty if there is none. All users of the machine can see a running
    command line, but neither a file nor the environment. Raise CallerError if both options are given, if the
    file has no token, and if a ``required`` token is missing."""
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
    """Return a time that a person typed, by the clock of the site unless it names another. Raise CallerError
    with the message of ``code`` for other text."""
    try:
        typed = datetime.fromisoformat(text.strip())
        return UnixTime((typed if typed.tzinfo else typed.replace(tzinfo=zone)).timestamp())
    except (ValueError, OverflowError):
        raise CallerError(Message.of(code, text=text)) from None
