"""The interface of a port to the line, and why a device cannot be opened and who has it open (Linux)."""

from __future__ import annotations

import asyncio
import errno
import grp
import math
import os
import pwd
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from bus.errors import WireError
from bus.messages import Message

SEARCH_S = 10.0
"""The seconds between two searches for a program that cannot be found, because its files are those of another
user."""
_found: dict[Path, tuple[float, list[tuple[int, str]]]] = {}
"""By device: when it was last searched for who has it, and who had."""


def why_not(path: str, error: Exception) -> Message:
    """Return why ``path`` cannot be opened, by the ``error`` that opening it raised."""
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
    """Return a message that other programs use ``path``, with their names. A port in use is tried twice a
    second, so they are searched for again only once those that were found have closed it."""
    device = Path(path).resolve()
    searched_at, users = _found.get(device, (-math.inf, []))
    is_known = all(_has_open(pid, device) for pid, _ in users)
    if not is_known or (not users and time.monotonic() - searched_at >= SEARCH_S):
        users = users_of(path)
        _found[device] = time.monotonic(), users
    return used_by(path, users)


def used_by(path: str, users: Iterable[tuple[int, str]]) -> Message:
    """Return a message that ``users`` (process id and name) have ``path``; if empty, another program."""
    programs = programs_of(users)
    if not programs:
        return Message.of("port_in_use", port=path)
    return Message.of("port_in_use_by", port=path, programs=programs)


def programs_of(users: Iterable[tuple[int, str]]) -> list[Message]:
    """Return programs, by process id and name, as the value of a message."""
    return [Message.of("process", program=name, pid=pid) for pid, name in users]


def _errno_in(error: Exception) -> int | None:
    """Return the errno of ``error``, or of its context, where pySerial leaves some; None if there is none."""
    for each in (error, error.__context__):
        if each is not None and each.args and isinstance(each.args[0], int):
            return each.args[0]
    return None


def _missing(path: str) -> Message:
    ports: list[str] = []
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


_PROC = Path("/proc")
_PSEUDO_TERMINALS = Path("/dev/pts")


def users_of(path: str) -> list[tuple[int, str]]:
    """Return process id and name of the others that lock ``path``, or without any, that have it open."""
    device = Path(path).resolve()
    own = {os.getpid(), *_simulators_of(device)}
    pids = _lockers(device) - own or {pid for pid in _pids() if _has_open(pid, device)} - own
    return [(pid, _name(pid)) for pid in sorted(pids)]


def is_device(path: str) -> bool:
    """Return whether ``path`` is a device, and not the URL of a device server."""
    return Path(path).is_char_device()


def is_pseudo_terminal(path: str) -> bool:
    """Return whether ``path`` is a pseudo-terminal, at whose other end a program plays the device."""
    return Path(path).resolve().parent == _PSEUDO_TERMINALS


def _simulators_of(device: Path) -> set[int]:
    """Return the programs at the other end of a pseudo-terminal: they simulate the line and are no other host
    on it."""
    if not is_pseudo_terminal(str(device)):
        return set()
    end = f"tty-index:\t{device.name}\n"
    return {pid for pid in _pids() if _has_end(pid, end)}


def _has_end(pid: int, end: str) -> bool:
    with suppress(OSError):
        for number, opened in _open_files(pid):
            if opened.name == "ptmx" and end in (_PROC / str(pid) / "fdinfo" / number).read_text():
                return True
    return False


def _lockers(device: Path) -> set[int]:
    try:
        inode = device.stat().st_ino
        lines = (_PROC / "locks").read_text().splitlines()
    except OSError:
        return set()
    found: set[int] = set()
    for words in map(str.split, lines):
        if len(words) >= 6 and words[1] == "FLOCK" and words[5].endswith(f":{inode}") and words[4].isdigit():
            found.add(int(words[4]))
    return {pid for pid in found if pid > 0 and _has_open(pid, device)}


def _pids() -> Iterator[int]:
    return (int(entry.name) for entry in _PROC.iterdir() if entry.name.isdigit())


def _has_open(pid: int, device: Path) -> bool:
    return any(opened == device and _is_same(pid, number, device) for number, opened in _open_files(pid))


def _is_same(pid: int, number: str, device: Path) -> bool:
    """Return whether a descriptor is of ``device``: each container has a pseudo-terminal 0 of its own."""
    with suppress(OSError):
        opened, wanted = (_PROC / str(pid) / "fd" / number).stat(), device.stat()
        is_here = opened.st_dev == wanted.st_dev or not is_pseudo_terminal(str(device))
        return is_here and opened.st_rdev == wanted.st_rdev
    return False


def _open_files(pid: int) -> Iterator[tuple[str, Path]]:
    """Yield the number of each descriptor of a process, and the file that it refers to."""
    with suppress(OSError):
        for descriptor in (_PROC / str(pid) / "fd").iterdir():
            with suppress(OSError):
                yield descriptor.name, descriptor.readlink()


def _name(pid: int) -> str:
    with suppress(OSError):
        return (_PROC / str(pid) / "comm").read_text().strip()
    return "a program"


class PortUnavailable(WireError):
    """Raised when the port cannot be opened now; the message has the reason and what to do."""


class EndedWhileOpening(PortUnavailable):
    """Raised when the other end accepted the connection and ended it before the port was open."""


class PartlySent(WireError):
    """Raised when the port took a part of a request and broke: whether a unit received it is not known."""


class Receiver(Protocol):
    """A receiver of the bytes of a port and of its loss."""

    def data_received(self, data: bytes) -> None:
        """Take bytes that came in."""

    def connection_lost(self, cause: Message) -> None:
        """Note that the port is gone, and why. This is called once, never after ``close``."""


class OpenPort(Protocol):
    """An open port. It is single-use: once lost or closed it is reopened as a new one."""

    def write(self, data: bytes) -> None:
        """Send one request at once. Raise PartlySent if only a part was taken, WireError if nothing was."""

    def listen(self, *, now: bool) -> None:
        """Deliver bytes at once if ``now``, else let them gather until the next call."""

    def drop_output(self) -> None:
        """Drop the bytes that have not left yet."""

    def retune(self, baud: int) -> None:
        """Continue at ``baud``. Raise WireError if the port cannot."""

    def check(self) -> list[str]:
        """Return the settings that another program has changed since the last call; they were restored. Raise
        WireError if the port is gone and this was not reported yet."""

    def close(self) -> None:
        """Release the port at once."""


class PortProtocol(asyncio.Protocol):
    """The protocol between an asyncio transport and a Receiver. ``gone``: reported on a loss."""

    def __init__(self, receiver: Receiver, gone: Message) -> None:
        self.made: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.closed = False
        self._gone = gone
        self._receiver = receiver
        self.data_received = receiver.data_received  # type: ignore[method-assign]

    def connection_made(self, _transport: asyncio.BaseTransport) -> None:
        if not self.made.done():
            self.made.set_result(None)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.closed:
            self.closed = True
            cause, number = self._gone, getattr(exc, "errno", None)
            if number:
                cause = Message.of("port_lost_error", reason=cause, error=os.strerror(number))
            self._receiver.connection_lost(cause)
