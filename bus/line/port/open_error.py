"""Why a device cannot be opened, and what to do about it, in words."""

from __future__ import annotations

import errno
import grp
import os
import pwd
from contextlib import suppress
from pathlib import Path

from bus.line.port.device_users import users_of


def why_not(path: str, error: Exception) -> str:
    """``error`` is what opening ``path`` raised."""
    number = getattr(error, "errno", None) or _errno_in(error)
    if number == errno.ENOENT:
        return f"{path} is not there: is the adapter plugged in?{_others()}"
    if number in (errno.EACCES, errno.EPERM):
        return f"{path} may not be opened: {_permission_advice(path)}"
    if number in (errno.EAGAIN, errno.EBUSY):
        return in_use(path)
    if number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR):
        return f"{path} is not a serial port"
    if number is not None:
        return f"{path} cannot be opened ({os.strerror(number)})"
    return f"{path} cannot be opened ({error})"


def in_use(path: str) -> str:
    """Another program has it, and which."""
    return f"{path} is in use by {', '.join(users_of(path)) or 'another program'}"


def _errno_in(error: Exception) -> int | None:
    """pySerial keeps the number of some errors only in what they were raised from."""
    for each in (error, error.__context__):
        if each is not None and each.args and isinstance(each.args[0], int):
            return each.args[0]
    return None


def _others() -> str:
    with suppress(OSError):
        names = sorted(str(entry) for entry in Path("/dev/serial/by-id").iterdir())
        if names:
            return f" There is: {', '.join(names)}"
    return ""


def _permission_advice(path: str) -> str:
    try:
        group = grp.getgrgid(Path(path).stat().st_gid).gr_name
        user = pwd.getpwuid(os.geteuid()).pw_name
    except (OSError, KeyError):
        return "the user that runs lineside needs the right to read and write it"
    return f"add the user to its group, 'sudo usermod -aG {group} {user}', and log in again"
