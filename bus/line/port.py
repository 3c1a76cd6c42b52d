"""A port as the rest of the line sees it, and why a device cannot be opened and who has it (Linux)."""

from __future__ import annotations

import asyncio
import errno
import grp
import os
import pwd
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from bus.errors import WireError
from bus.messages import Message


def why_not(path: str, error: Exception) -> Message:
    """Return why ``path`` cannot be opened, by the ``error`` that this raised."""
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
    """Return that another program has it, and which."""
    return used_by(path, users_of(path))


def used_by(path: str, users: Iterable[tuple[int, str]]) -> Message:
    """Return that these programs have it, by process id and name; without any, another program."""
    programs = programs_of(users)
    if not programs:
        return Message.of("port_in_use", port=path)
    return Message.of("port_in_use_by", port=path, programs=programs)


def programs_of(users: Iterable[tuple[int, str]]) -> list[Message]:
    """Return programs by process id and name as the value of a message."""
    return [Message.of("process", program=name, pid=pid) for pid, name in users]


def _errno_in(error: Exception) -> int | None:
    """Return the number of an error; pySerial keeps some only in what they were raised from."""
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
    """Return process id and name of the others that hold a lock on it, else of those that have it open."""
    device = Path(path).resolve()
    own = {os.getpid(), *_simulators_of(device)}
    pids = _lockers(device) - own or {pid for pid in _pids() if _has_open(pid, device)} - own
    return [(pid, _name(pid)) for pid in sorted(pids)]


def is_device(path: str) -> bool:
    """Return whether a device is there, and not the URL of a device server."""
    return Path(path).is_char_device()


def is_pseudo_terminal(path: str) -> bool:
    """Return whether this is a pseudo-terminal, at whose other end a program plays the device."""
    return Path(path).resolve().parent == _PSEUDO_TERMINALS


def _simulators_of(device: Path) -> set[int]:
    """Return the programs at the other end of a pseudo-terminal: they are the line, and no other host on
    it."""
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
    """Return the number of each descriptor of a process, and what it is of."""
    with suppress(OSError):
        for descriptor in (_PROC / str(pid) / "fd").iterdir():
            with suppress(OSError):
                yield descriptor.name, descriptor.readlink()


def _name(pid: int) -> str:
    with suppress(OSError):
        return (_PROC / str(pid) / "comm").read_text().strip()
    return "a program"


class PortUnavailable(WireError):
    """The port cannot be opened now; the message has the reason and what to do."""


class EndedWhileOpening(PortUnavailable):
    """The other end took the connection and ended it before the port was open."""


class PartlySent(WireError):
    """The port took some of a request and broke: whether a unit received it is not known."""


class Receiver(Protocol):
    """Called with what comes from the port."""

    def data_received(self, data: bytes) -> None:
        """Take bytes that came in."""

    def connection_lost(self, cause: Message) -> None:
        """Note that the port is gone, and why. Called once, never after ``close``."""


class OpenPort(Protocol):
    """An open port. It is single-use: once lost or closed it is reopened as a new one."""

    def write(self, data: bytes) -> None:
        """Hand over one request at once. Raises PartlySent where some of it was taken, else WireError."""

    def listen(self, *, now: bool) -> None:
        """Give what comes in at once, or let it gather until this is called again."""

    def drop_output(self) -> None:
        """Forget what has not left yet."""

    def retune(self, baud: int) -> None:
        """Go on at ``baud``. Raises WireError where the port cannot."""

    def check(self) -> list[str]:
        """Return what another program changed of its settings since the last call, which was put back. Raises
        WireError when the port is gone and this was not reported yet."""

    def close(self) -> None:
        """Give it back, at once."""


class PortProtocol(asyncio.Protocol):
    """Between an asyncio transport and a Receiver. ``gone``: what is reported when the port is lost."""

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
