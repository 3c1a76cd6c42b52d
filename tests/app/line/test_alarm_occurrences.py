"""When alarms were active, for a chart."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from app.line.alarms.journal import MAX_OCCURRENCES, AlarmStore, occurrences
from bus.instants import UnixTime
from tests.app.alarm_journal import Journal, T, alarm_journal

RISE = ("rise", "normal", "unack_active")
SEEN = ("acknowledge", "unack_active", "ack_active")
CLEAR = ("clear", "ack_active", "normal")


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with alarm_journal(tmp_path) as journal:
        yield journal


async def spans(
    journal: Journal, start: float, end: float, *alarms: str
) -> list[tuple[str, float, float | None]]:
    """The alarm, start and end of each, in seconds after T."""
    found = await occurrences(journal.store, alarms or ("a", "b"), UnixTime(T + start), UnixTime(T + end))
    return [(each.alarm, each.start - T, None if each.end is None else each.end - T) for each in found]


async def test_an_alarm_is_marked_from_its_rise_to_its_end(journal: Journal) -> None:
    journal.write("a", (10, *RISE), (20, *SEEN), (30, *CLEAR))
    journal.write("b", (12, *RISE))
    assert await spans(journal, 0, 60) == [("a", 10, 30), ("b", 12, None)]
    assert await spans(journal, 0, 60, "b") == [("b", 12, None)]


async def test_one_that_began_before_a_span_or_ended_after_it_has_its_own_times(journal: Journal) -> None:
    journal.write("a", (10, *RISE), (15, *SEEN), (40, *CLEAR), (50, *RISE))
    assert await spans(journal, 20, 30) == [("a", 10, 40)]
    assert await spans(journal, 40, 45) == []
    assert await spans(journal, 0, 5) == []
    assert await spans(journal, 45, 60) == [("a", 50, None)]


async def test_what_was_hidden_is_not_marked_until_it_is_annunciated(journal: Journal) -> None:
    journal.write("a", (10, "rise", "suppressed", "suppressed"), (20, "unsuppress", "suppressed", RISE[2]))
    journal.write("b", (10, *RISE), (15, "shelve", "unack_active", "shelved"))
    assert await spans(journal, 0, 60) == [("b", 10, 15), ("a", 20, None)]


async def test_of_very_many_the_newest_are_marked(journal: Journal) -> None:
    journal.rise("a", *range(2 * MAX_OCCURRENCES))
    found = await spans(journal, 0, 5000)
    assert len(found) == MAX_OCCURRENCES + 1, "one more than fit shows that there are more"
    assert found[-1][1] == 2 * MAX_OCCURRENCES - 1


class CountingStore:
    """Counts the hundreds of steps that SQLite takes for a read."""

    def __init__(self, store: AlarmStore) -> None:
        self._store = store
        self.steps = 0

    async def read_costly(self, work: Callable[[sqlite3.Connection], Any]) -> Any:
        def counted(connection: sqlite3.Connection) -> Any:
            connection.set_progress_handler(self._step, 100)
            return work(connection)

        return await self._store.read_costly(counted)

    def _step(self) -> None:
        self.steps += 1


async def steps_for(journal: Journal, end: float, *alarms: str) -> tuple[int, int]:
    """How many occurrences from T on, and what they cost."""
    store = CountingStore(journal.store)
    found = await occurrences(store, alarms, UnixTime(T), UnixTime(T + end))  # type: ignore[arg-type]
    return len(found), store.steps


async def test_what_happened_while_an_alarm_was_hidden_costs_nothing(journal: Journal) -> None:
    hidden = ("shelved", "shelved")
    journal.write("a", *((at, ("rise", "clear")[at % 2], *hidden) for at in range(10_000)))
    found, steps = await steps_for(journal, 10_000, "a")
    assert found == 0
    assert steps < 200, "of which the search for the end of the time takes a thousand entries"


async def test_of_many_alarms_that_came_often_only_the_newest_cost(journal: Journal) -> None:
    alarms = [str(number) for number in range(50)]
    for offset, alarm in enumerate(alarms):
        journal.rise(alarm, *(offset / 100 + at for at in range(400)))
    found, steps = await steps_for(journal, 400, *alarms)
    assert found == MAX_OCCURRENCES + 1
    assert steps < 3000, "and 20,000 occurrences were not looked at"
