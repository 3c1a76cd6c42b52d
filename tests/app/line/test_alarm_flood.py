"""A process that is killed in a flood of changes: its journal is complete, its states follow from it."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import pytest

from app.core.database import Database
from app.line.alarms.journal import AlarmStore, JournalEntry
from tests.sizes import sizes


def flood_and_kill(store: Path, passes: int) -> None:
    """Let it write some passes, then kill it in the next."""
    command = [sys.executable, "-m", "tests.app.alarm_flood", str(store)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as flood:
        assert flood.stdout is not None
        for _ in range(passes):
            assert flood.stdout.readline() == "written\n"
        flood.kill()


def check_chain(entries: list[JournalEntry]) -> None:
    """Each transition of an alarm begins where the one before ended, and no occurrence is left out."""
    state, occurrence = "normal", 0
    for entry in entries:
        assert entry.before == state
        occurrence += entry.trigger == "rise"
        assert entry.occurrence == occurrence
        state = entry.after


@pytest.mark.parametrize("kills", sizes(2, 50))
async def test_a_kill_in_a_flood_loses_and_repeats_no_transition(tmp_path: Path, kills: int) -> None:
    path = tmp_path / "store.db"
    dice = random.Random(14)
    for _ in range(kills):
        flood_and_kill(path, dice.randint(3, 12))
    database = Database(path)
    store = AlarmStore(database)
    journal = await store.journal(1_000_000, None)
    stored = await store.load()
    database.close()
    by_alarm: dict[str, list[JournalEntry]] = {}
    for entry in reversed(journal):
        by_alarm.setdefault(entry.alarm, []).append(entry)
    assert len(journal) > 100
    for key, entries in by_alarm.items():
        check_chain(entries)
        assert (stored[key].facts.state, stored[key].facts.occurrence) == (
            entries[-1].after,
            entries[-1].occurrence,
        )
