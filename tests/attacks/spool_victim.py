"""Processes that take in readings and are killed: each forked from this one, which has imported everything.

For each line on its input, the number of the first batch, it forks one that prints each batch whose readings
are on a disk. ``python -m tests.attacks.spool_victim FOLDER``.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest

from bus.contract import Update
from tests.app.away_history import quickly, writer_of
from tests.app.history_line import BUS, NOON, reading

BATCH = 5


def batch(number: int) -> list[Update]:
    """A second of equal readings, of a speed that differs from batch to batch every other time."""
    return [reading(NOON + number + i / BATCH, number // 2) for i in range(BATCH)]


def live(folder: Path, first: int, report: int) -> None:
    """Until it is killed."""
    with pytest.MonkeyPatch.context() as patch, quickly(patch, folder):
        writer = writer_of(folder)
        number = first
        while True:
            writer.take((BUS.name, batch(number)))
            while writer.status.waiting:
                time.sleep(0.001)
            os.write(report, f"{number}\n".encode())
            number += 1


def main(folder: Path) -> None:
    """Fork, name the process, wait for its end."""
    # The log goes where errors go.
    report = os.dup(1)
    os.dup2(2, 1)
    for line in iter(sys.stdin.readline, ""):
        child = os.fork()
        if not child:
            live(folder, int(line), report)
        os.write(report, f"process {child}\n".encode())
        os.waitpid(child, 0)
        os.write(report, b"ended\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
