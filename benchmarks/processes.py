"""What processes use, read from /proc."""

from __future__ import annotations

import os
from pathlib import Path

_PAGE = os.sysconf("SC_PAGE_SIZE")


def family(root: int) -> list[int]:
    """A process and all that it has started, and they."""
    children = Path(f"/proc/{root}/task/{root}/children")
    direct = [int(child) for child in children.read_text().split()] if children.exists() else []
    return [root, *(member for child in direct for member in family(child))]


def cpu_seconds(*processes: int) -> float:
    """User and system time used so far, together: to the nanosecond, not in ticks of the clock."""
    tasks = (task for process in processes for task in Path(f"/proc/{process}/task").iterdir())
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e9


def memory_mib(*processes: int) -> float:
    """Resident memory, together."""
    pages = sum(int(Path(f"/proc/{process}/statm").read_text().split()[1]) for process in processes)
    return pages * _PAGE / 2**20
