"""The clock of the server is set back between entries: no time that is shown or averaged is negative."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from app.core.database import Database
from app.line.alarms.journal import measure, occurrences
from app.line.alarms.rules.performance import CHATTERS_S, FLEETING_S, ObservedSpan
from bus.instants import UnixTime
from tests.app.alarm_bus import AlarmBus
from tests.app.alarm_journal import Journal, T, alarm_journal
from tests.app.history_line import NOON, Shelf
from tests.app.line.test_alarm_simulation import keep, simulated, steadily

STEP = st.sampled_from((-7200.0, -3600.0, -20.0, -1.0, 0.0, 1.0, 5.0, 20.0, 400.0))


class Cycle(NamedTuple):
    """An alarm rises at ``risen``, is acknowledged at ``seen`` and clears at ``cleared``."""

    risen: float
    seen: float
    cleared: float


@st.composite
def cycles(draw: st.DrawFn) -> list[Cycle]:
    """Of one alarm, one after the other, by a clock that is set between any two entries."""
    at, found = 10_000.0, []
    for _ in range(draw(st.integers(1, 6))):
        times = []
        for _ in Cycle._fields:
            at += draw(STEP)
            times.append(at)
        found.append(Cycle(*times))
    return found


ALWAYS_BACK = [Cycle(*(-7200.0 * (3 * cycle + entry) for entry in range(3))) for cycle in range(6)]


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Journal]:
    with alarm_journal(tmp_path_factory.mktemp("journal")) as journal:
        yield journal


number = iter(range(1_000_000))
REACH_S = 130_000.0
"""More than all steps of some cycles together, which may all go back."""


def written(journal: Journal, several: list[Cycle]) -> tuple[str, float]:
    """The alarm with these cycles, and the begin of a time that only it has."""
    alarm = next(number)
    begin = 4 * REACH_S * alarm
    for risen, seen, cleared in several:
        journal.write(
            str(alarm),
            (begin + risen, "rise", "normal", "unack_active"),
            (begin + seen, "acknowledge", "unack_active", "ack_active"),
            (begin + cleared, "clear", "ack_active", "normal"),
        )
    return str(alarm), begin


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(several=cycles())
async def test_figures_leave_out_what_the_clock_made_negative(journal: Journal, several: list[Cycle]) -> None:
    _, begin = written(journal, several)
    start, end = UnixTime(T + begin - REACH_S), UnixTime(T + begin + REACH_S)
    journal.spans = [ObservedSpan(start, end)]
    performance = await measure(journal.store, [], journal.spans, start, end)
    found = {figure.code: figure.value for figure in performance.figures}
    assert [code for code, value in found.items() if value is not None and value < 0] == []
    delays = [seen - risen for risen, seen, _ in several if seen >= risen]
    median = pytest.approx(statistics.median(delays)) if delays else None
    assert found["acknowledge_median_s"] == median
    risen = [each.risen for each in several]
    threes = zip(risen, risen[1:], risen[2:], strict=False)
    chatters = any(a <= b <= c <= a + CHATTERS_S for a, b, c in threes)
    assert found["chattering"] == chatters


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@example(several=ALWAYS_BACK)
@given(several=cycles())
async def test_an_occurrence_never_ends_before_it_began(journal: Journal, several: list[Cycle]) -> None:
    alarm, begin = written(journal, several)
    span = UnixTime(T + begin - REACH_S), UnixTime(T + begin + REACH_S)
    found = await occurrences(journal.store, [alarm], *span)
    assert len(found) == len(several)
    assert [each for each in found if each.end is not None and each.end < each.start] == []


@pytest.mark.parametrize(("cleared_at", "fleeting"), [(5, 1), (FLEETING_S + 1, 0), (-3600, 0)])
async def test_an_alarm_from_before_the_clock_was_set_back_is_not_fleeting(
    tmp_path: Path, cleared_at: float, fleeting: int
) -> None:
    with alarm_journal(tmp_path) as journal:
        journal.write(
            "a", (0, "rise", "normal", "unack_active"), (cleared_at, "clear", "unack_active", "rtn_unack")
        )
        performance = await measure(journal.store, [], journal.spans, UnixTime(T - 9000), UnixTime(T + 9000))
        assert {figure.code: figure.value for figure in performance.figures}["fleeting"] == fleeting


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(start=st.integers(0, 5000), length=st.integers(1, 6000))
def test_a_simulation_has_nothing_from_outside_of_its_time(shelf: Shelf, start: int, length: int) -> None:
    """Tenths of a second; complete minutes are read, and both ends are within one."""
    begin, end = NOON + start / 10, NOON + (start + length) / 10
    with closing(Database(shelf.database.path.with_name("alarms.db"))) as database:
        bus = AlarmBus(database, units=1)
        replay = simulated(shelf, bus, {"value": "actual", "above": 105, "on_delay_s": 3}, 20, begin, end)
    replay.end(UnixTime(end))
    replay.found.end(UnixTime(end))
    assert 0 <= replay.unknown_s <= length / 10 + 0.001
    assert [at for at in replay.found.at if not begin <= at <= end] == []
    assert [each for each in replay.found.lengths if each < 0] == []


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shelf]:
    """Ten minutes of a unit that is too fast at times, and does not respond for the third."""
    shelf = Shelf(tmp_path_factory.mktemp("shelf") / "history.db")
    fast = {(start, start + 8.0): {"actual": 1100} for start in range(0, 600, 25)}
    keep(shelf, [each for each in steadily(fast, 10) if not 120 <= each[0] - NOON < 180])
    yield shelf
    shelf.close()
