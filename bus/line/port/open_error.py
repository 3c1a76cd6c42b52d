"""Why a device cannot be opened, and what to do about it."""

from __future__ import annotations

import errno
import grp
import os
import pwd
from contextlib import suppress
from pathlib import Path

from bus.line.port.device_users import users_of
from bus.messages import Message


def why_not(path: str, error: Exception) -> Message:
    """``error`` is what opening ``path`` raised."""
    number = getattr(error, "errno", None) or _errno_in(error)
    if number == errno.ENOENT:
        return _missing(path)
    if number in (errno.EACCES, errno.EPERM):
        return _not_permitted(path)
    if number in (errno.EAGAIN, errno.EBUSY):
        return in_use(path)
    if number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR):
        return Message.of("port_not_serial", port=path)
    why = os.strerror(number) if number is not None else str(error)
    return Message.of("port_not_opened_error", port=path, error=why)


def in_use(path: str) -> Message:
    """Another program has it, and which."""
    programs: list[int | str | Message] = [
        Message.of("process", program=name, pid=pid) for pid, name in users_of(path)
    ]
    if not programs:
        return Message.of("port_in_use", port=path)
    return Message.of("port_in_use_by", port=path, programs=programs)


def _errno_in(error: Exception) -> int | None:
    """pySerial keeps the number of some errors only in what they were raised from."""
    for each in (error, error.__context__):
        if each is not None and each.args and isinstance(each.args[0], int):
            return each.args[0]
    return None


def _missing(path: str) -> Message:
    ports: list[int | str | Message] = []
    with suppress(OSError):
        ports += sorted(str(entry) for entry in Path("/dev/serial/by-id").iterdir())
    if not ports:
        return Message.of("port_missing", port=path)
    return Message.of("port_missing_others", port=path, ports=ports)


def _not_permitted(path: str) -> Message:
    try:
        group = grp.getgrgid(Path(path).stat().st_gid).gr_name
        user = pwd.getpwuid(os.geteuid()).pw_name
    except (OSError, KeyError):
        return Message.of("port_not_permitted", port=path)
    return Message.of("port_not_permitted_group", port=path, group=group, user=user)
