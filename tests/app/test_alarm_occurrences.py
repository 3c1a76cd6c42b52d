"""When alarms were active, for a chart."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from app.alarms.occurrences import MOST_OCCURRENCES, occurrences
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
    journal.rise("a", *range(2 * MOST_OCCURRENCES))
    found = await spans(journal, 0, 5000)
    assert len(found) == MOST_OCCURRENCES + 1, "one more than fit tells that there are more"
    assert found[-1][1] == 2 * MOST_OCCURRENCES - 1
