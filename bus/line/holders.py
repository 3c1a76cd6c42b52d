"""Which programs have a device open, as Linux shows it under /proc."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

_PROC = Path("/proc")


def holders_of(path: str) -> list[str]:
    """``name (process 123)`` of the others that hold a lock on it, else of those that have it open."""
    device = Path(path).resolve()
    own = {os.getpid()}
    pids = _lockers(device) - own or _openers(device) - own
    return [f"{_name(pid)} (process {pid})" for pid in sorted(pids)]


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
    pids = (int(entry.name) for entry in _PROC.iterdir() if entry.name.isdigit())
    return {pid for pid in pids if _has_open(pid, device)}


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
