"""Which programs have a device open, as Linux shows it under /proc."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_PROC = Path("/proc")
_PLAYED = Path("/dev/pts")


def users_of(path: str) -> list[tuple[int, str]]:
    """Process id and name of the others that hold a lock on it, else of those that have it open."""
    device = Path(path).resolve()
    own = {os.getpid(), *_played_by(device)}
    pids = _lockers(device) - own or _openers(device) - own
    return [(pid, _name(pid)) for pid in sorted(pids)]


def is_played(path: str) -> bool:
    """Whether this is a pseudo-terminal, at whose other end a program plays the device."""
    return Path(path).resolve().parent == _PLAYED


def _played_by(device: Path) -> set[int]:
    """The programs at the other end of a pseudo-terminal: they are the line, and no other host on it."""
    if not is_played(str(device)):
        return set()
    end = f"tty-index:\t{device.name}\n"
    return {pid for pid in _pids() if _has_end(pid, end)}


def _has_end(pid: int, end: str) -> bool:
    with suppress(OSError):
        for descriptor in (_PROC / str(pid) / "fd").iterdir():
            with suppress(OSError):
                is_end = descriptor.readlink().name == "ptmx"
                if is_end and end in (_PROC / str(pid) / "fdinfo" / descriptor.name).read_text():
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


def _openers(device: Path) -> set[int]:
    return {pid for pid in _pids() if _has_open(pid, device)}


def _pids() -> Iterator[int]:
    return (int(entry.name) for entry in _PROC.iterdir() if entry.name.isdigit())


def _has_open(pid: int, device: Path) -> bool:
    with suppress(OSError):
        for descriptor in (_PROC / str(pid) / "fd").iterdir():
            with suppress(OSError):
                if descriptor.readlink() == device:
                    return True
    return False


def _name(pid: int) -> str:
    with suppress(OSError):
        return (_PROC / str(pid) / "comm").read_text().strip()
    return "a program"
