"""What processes use, read from /proc."""

from __future__ import annotations

import os
from pathlib import Path

_TICKS = os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGE_SIZE")


def family(root: int) -> list[int]:
    """A process and all that it has started, and they."""
    children = Path(f"/proc/{root}/task/{root}/children")
    direct = [int(child) for child in children.read_text().split()] if children.exists() else []
    return [root, *(member for child in direct for member in family(child))]


def cpu_seconds(*processes: int) -> float:
    """User and system time used so far, together."""
    return sum(_stat(process, 11) + _stat(process, 12) for process in processes) / _TICKS


def memory_mib(*processes: int) -> float:
    """Resident memory, together."""
    pages = sum(int(Path(f"/proc/{process}/statm").read_text().split()[1]) for process in processes)
    return pages * _PAGE / 2**20


def _stat(process: int, field: int) -> int:
    return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[field])
