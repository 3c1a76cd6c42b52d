"""A server that is killed at any moment, with a database that comes and goes: what was on a disk is stored,
once."""

from __future__ import annotations

import os
import random
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from app.history.series.runs import SECOND, micros
from tests.app.away_history import quickly, stored_in, writer_of
from tests.app.history_line import NOON, until
from tests.attacks.spool_victim import BATCH
from tests.sizes import sizes

ROOT = Path(__file__).parents[2]


class Victims:
    """The processes, one after the other. ``acknowledged``: the batches that one of them reported as on a
    disk; ``unknown``: the others that may be."""

    def __init__(self, folder: Path) -> None:
        command = [sys.executable, "-m", "tests.attacks.spool_victim", str(folder)]
        with (folder / "log").open("wb") as log:
            self._host = subprocess.Popen(
                command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, bufsize=0
            )
        self.acknowledged: set[int] = set()
        self.unknown: set[int] = set()

    def live(self, first: int, life_s: float, play: list[Path], chance: random.Random) -> int:
        """One life, in which the database comes and goes; return the first number of the next."""
        assert self._host.stdin is not None
        assert self._host.stdout is not None
        self._host.stdin.write(f"{first}\n".encode())
        child, end, last = 0, 0.0, first - 1
        while (line := self._line(0.02)) != b"ended":
            if line.startswith(b"process"):
                child = int(line.split()[1])
                end = time.monotonic() + life_s
            elif line:
                last = int(line)
                self.acknowledged.add(last)
            if child and time.monotonic() >= end:
                os.kill(child, signal.SIGKILL)
            if chance.random() < 0.1:
                _toggle(chance.choice(play))
        self.unknown.add(last + 1)
        return last + 2

    def end(self) -> None:
        self._host.communicate()

    def _line(self, patience_s: float) -> bytes:
        assert self._host.stdout is not None
        if not select.select([self._host.stdout], [], [], patience_s)[0]:
            return b""
        line = self._host.stdout.readline()
        assert line, "the process that forks ended"
        return line.strip()


def _toggle(file: Path) -> None:
    if file.exists():
        file.unlink()
    else:
        file.touch()


@pytest.mark.parametrize("lives", sizes(12, 150))
def test_no_reading_that_was_on_a_disk_is_lost_or_doubled(
    lives: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chance = random.Random(lives)
    play = [tmp_path / "away", tmp_path / "away", tmp_path / "mute"]
    victims, first = Victims(tmp_path), 0
    for _ in range(lives):
        first = victims.live(first, chance.uniform(0.0, 0.4), play, chance)
    victims.end()
    for file in play:
        file.unlink(missing_ok=True)
    with quickly(monkeypatch, tmp_path):
        writer = writer_of(tmp_path)
        until(lambda: writer.status.spooled_readings == 0)
        runs = stored_in(writer, NOON, NOON + first)
        writer.close()
    found: Counter[int] = Counter()
    for run in runs:
        # A run ends with its minute or its speed; it can span two batches.
        between = (run.until - run.at) * BATCH // SECOND + 1
        assert run.readings == between, run
        for place in range(run.readings):
            found[(run.at - micros(NOON) + place * SECOND // BATCH) // SECOND] += 1
    assert victims.acknowledged, "no life was long enough"
    assert {number: found[number] for number in victims.acknowledged if found[number] != BATCH} == {}
    assert set(found) <= victims.acknowledged | victims.unknown
    assert max(found.values()) == BATCH
