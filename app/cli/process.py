"""The process of a command: its exit codes (0 done, 1 failed, 2 wrong use), what it reports, in English, and
its rights."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from bus.errors import CallerError, LinesideError
from bus.messages import Message, ParamValue

WRONG_CONFIGURATION = os.EX_CONFIG
"""Exit code of a service whose configuration is wrong: another start would end the same way."""


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
        raise  # the reader of the output has left: click ends without a message
    except OSError as error:
        complain(Message.of("system_error", error=str(error)))
        raise click.exceptions.Exit(1) from error


def wrong_option(option: str, code: str, **params: ParamValue) -> click.BadParameter:
    """Make the error of a wrong value of ``option`` (exit code 2), by the code of its message."""
    return click.BadParameter(str(Message(code, params)), param_hint=option)


def report(message: Message, *, err: bool = False) -> None:
    """Print a line to standard output or standard error."""
    click.echo(str(message), err=err)


def complain(reason: Message) -> None:
    """Print a line to standard error that names the program, as Unix tools do."""
    report(Message.of("command_failed", reason=reason), err=True)


def become_owner_of(folder: Path) -> None:
    """Go on as the owner of a folder, for good, if root calls and the folder belongs to another user: the
    files of the service stay its own. A missing folder counts as owned by the owner of the folder that it
    would be made in."""
    if os.geteuid() != 0 or (owner := _owner(folder)) is None:
        return
    uid, gid = owner
    os.setgroups(_groups_of(uid, gid))
    os.setresgid(gid, gid, gid)
    os.setresuid(uid, uid, uid)


@contextmanager
def acting_as_owner_of(folder: Path) -> Iterator[None]:
    """Act as the owner of a folder within this context, as `become_owner_of` does for good."""
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
    """Return user and group of the folder, or of the nearest parent that exists; None if that is root."""
    nearest = next((each for each in (folder, *folder.parents) if os.path.isdir(each)), None)  # noqa: PTH112
    if nearest is None:
        return None
    found = nearest.stat()
    return (found.st_uid, found.st_gid) if found.st_uid != 0 else None


def _groups_of(uid: int, gid: int) -> list[int]:
    """Return the groups of a user, such as that of the serial ports; a user without a name has its own
    alone."""
    # Only root comes here; every other command does without the module.
    import pwd

    try:
        return os.getgrouplist(pwd.getpwuid(uid).pw_name, gid)
    except KeyError:
        return [gid]
