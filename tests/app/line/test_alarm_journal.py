"""What the journal of alarms says of a span: the figures of ISA-18.2 and the occurrences of a chart, also
where the clock of the server was set back between entries."""

from __future__ import annotations

import sqlite3
import statistics
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from app.core.database import Database
from app.line.alarms.journal import MAX_OCCURRENCES, AlarmPerformance, AlarmStore, measure, occurrences
from app.line.alarms.performance import (
    CHATTERS_S,
    FEW,
    FLEETING_S,
    MANY,
    MAX_GAP_S,
    MIN_FOR_TOP_TEN,
    WINDOW_S,
    AlarmCounts,
    AlarmPace,
    AlarmRates,
    ObservedSpan,
    figures,
    observed_until,
    pace_of,
)
from bus.instants import UnixTime

T = 1_790_000_400.0
"""When the journals of these tests begin."""


class Journal:
    """An alarm list without alarms, over a journal that a test writes."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self.store = AlarmStore(database)
        self.spans = [ObservedSpan(UnixTime(T), UnixTime(T + 1800))]

    def write(self, alarm: str, *rows: tuple[float, str, str, str], priority: str = "low") -> None:
        """Transitions of one alarm: seconds after T, trigger, state before, state after."""
        occurrence = 0
        values = []
        for at, trigger, before, after in rows:
            occurrence += trigger == "rise"
            values.append((T + at, alarm, occurrence, priority, trigger, before, after))
        statement = (
            "INSERT INTO alarm_journal (at, alarm, occurrence, code, name, priority, trigger, before, after,"
            " who, reason) VALUES (?, ?, ?, 'x', 'X', ?, ?, ?, ?, '', '')"
        )
        self._database.write_now(lambda connection: connection.executemany(statement, values))

    def rise(self, alarm: str, *at: float, priority: str = "low") -> None:
        """It rises at each time, and is normal again half a second later."""
        for each in at:
            self.write(
                alarm,
                (each, "rise", "normal", "unack_active"),
                (each + 0.25, "acknowledge", "unack_active", "ack_active"),
                (each + 0.5, "clear", "ack_active", "normal"),
                priority=priority,
            )


@contextmanager
def alarm_journal(folder: Path) -> Iterator[Journal]:
    """An empty one, in a new store."""
    with closing(Database(folder / "store.db")) as database:
        yield Journal(database)


def values(performance: AlarmPerformance) -> dict[str, float | None]:
    return {figure.code: figure.value for figure in performance.figures}


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with alarm_journal(tmp_path) as journal:
        yield journal


async def performance_of(journal: Journal, seconds: float) -> AlarmPerformance:
    return await measure(journal.store, [], journal.spans, UnixTime(T), UnixTime(T + seconds))


async def measured(journal: Journal, seconds: float) -> dict[str, float | None]:
    return values(await performance_of(journal, seconds))


async def test_the_figures_have_rates_the_peak_and_the_share_of_each_priority(journal: Journal) -> None:
    journal.rise("a", 0, 700, 1300, priority="high")
    journal.rise("b", *range(10, 130, 10))
    found = await measured(journal, 1800)
    assert (found["annunciated"], found["per_10_minutes"], found["per_day"]) == (15, 5, 720)
    assert (found["peak_10_minutes"], found["windows_over_10"]) == (13, pytest.approx(520 / 1800))
    assert (found["high_share"], found["low_share"], found["urgent_share"]) == (0.2, 0.8, 0)


async def test_an_empty_journal_has_no_shares_and_meets_no_target_by_them(journal: Journal) -> None:
    performance = await performance_of(journal, 600)
    assert values(performance)["low_share"] is None
    assert {figure.code: figure.met for figure in performance.figures}["low_share"] is None
    assert {figure.code: figure.met for figure in performance.figures}["per_day"] is True


async def test_three_times_in_a_minute_chatters(journal: Journal) -> None:
    journal.rise("chatters", 0, 30, 60)
    journal.rise("often", 0, 40, 80)
    assert (await measured(journal, 600))["chattering"] == 1


async def test_what_clears_before_a_person_could_act_is_fleeting(journal: Journal) -> None:
    for alarm, clears_at in (("fleeting", 10), ("lasting", 11)):
        journal.write(
            alarm, (0, "rise", "normal", "unack_active"), (clears_at, "clear", "unack_active", "rtn_unack")
        )
    journal.rise("acknowledged", 0)
    assert (await measured(journal, 600))["fleeting"] == 1


async def test_the_median_time_to_an_acknowledgement_is_a_figure(journal: Journal) -> None:
    for alarm, after_s in (("a", 10), ("b", 30), ("c", 500), ("d", 40)):
        journal.write(
            alarm,
            (0, "rise", "normal", "unack_active"),
            (after_s, "acknowledge", "unack_active", "ack_active"),
        )
    assert (await measured(journal, 600))["acknowledge_median_s"] == 35


async def test_a_hidden_alarm_is_not_counted_until_it_is_annunciated(journal: Journal) -> None:
    journal.write(
        "a", (0, "rise", "suppressed", "suppressed"), (5, "unsuppress", "suppressed", "unack_active")
    )
    journal.write("b", (0, "rise", "shelved", "shelved"))
    assert (await measured(journal, 600))["annunciated"] == 1


async def test_a_rate_is_of_the_time_that_was_observed(journal: Journal) -> None:
    """The server ran for the first ten minutes of a week and, a day later, for twenty."""
    later = UnixTime(T + 86_400)
    await journal.store.write_observed("_", ObservedSpan(UnixTime(T - 60), UnixTime(T + 600)))
    await journal.store.write_observed("dry-end", ObservedSpan(UnixTime(T), UnixTime(T + 600)))
    journal.spans = [ObservedSpan(later, UnixTime(later + 1200))]
    journal.rise("a", 1200, 86_400 + 30)
    performance = await performance_of(journal, 7 * 86_400)
    assert (performance.start, performance.observed_s) == (T, 1800)
    assert values(performance)["per_10_minutes"] == pytest.approx(2 / 3)
    assert (performance.is_observed, performance.covers(7 * 86_400)) == (True, False)
    assert [(top.alarm, top.times) for top in performance.most_frequent] == [("a", 2)]


@pytest.mark.parametrize("observed_s", [0, 599])
async def test_what_was_not_observed_meets_no_target(journal: Journal, observed_s: float) -> None:
    journal.spans = [ObservedSpan(UnixTime(T), UnixTime(T + observed_s))]
    performance = await performance_of(journal, 7 * 86_400)
    assert not performance.is_observed
    judged = {figure.code for figure in performance.figures if figure.met is not None}
    assert judged == {"stale"}, "which is of the present"
    assert [code for code, value in values(performance).items() if value is not None] == [
        *("stale", "standing", "shelved", "suppressed", "out_of_service")
    ]


def test_an_observed_span_grows_until_a_gap_or_a_step_of_the_clock() -> None:
    span = observed_until(UnixTime(T), None)
    assert observed_until(UnixTime(T + 1), span) == (T, T + 1)
    assert observed_until(UnixTime(T + MAX_GAP_S + 1), span) == (T + MAX_GAP_S + 1,) * 2
    assert observed_until(UnixTime(T - 1), span) == (T - 1, T - 1)


def test_a_flood_is_counted_in_ten_minutes_that_slide_as_the_list_counts_it() -> None:
    came = [T - 520 + 100 * n for n in range(6)] + [T + 10 * n for n in range(1, 6)]
    rates = AlarmRates()
    for at in came:
        rates.note(f"a{at}", UnixTime(at))
    assert pace_of(came, T + 1000) == (11, rates.flood(UnixTime(T + 50)), 30, 560)
    assert pace_of(came[:10], T + 1000) == (10, 10, 0, 0)
    assert pace_of(came, T + 60) == (11, 11, 10, 10)
    assert pace_of([], T) == (0, 0, 0, 0)


def test_each_figure_has_at_most_one_target() -> None:
    found = figures(AlarmCounts(600, AlarmPace(3, 3, 0, 0), 3, {"urgent": 3}, 0, 0, 700, {"stale": 5}))
    assert {figure.code for figure in found if figure.met is False} == {
        *("per_day", "per_10_minutes", "stale", "urgent_share", "low_share"),
        "acknowledge_median_s",
    }
    assert not [figure for figure in found if figure.at_most is not None and figure.at_least is not None]


@pytest.mark.parametrize(("total", "share"), [(MIN_FOR_TOP_TEN - 1, None), (MIN_FOR_TOP_TEN, 0.05)])
def test_the_ten_most_frequent_are_judged_where_they_can_keep_their_target(
    total: int, share: float | None
) -> None:
    found = figures(AlarmCounts(86_400, AlarmPace(total, 1, 0, 0), 10, {"low": total}, 0, 0, None, {}))
    (top_ten,) = [figure for figure in found if figure.code == "top_ten_share"]
    assert (top_ten.value, top_ten.met) == (share, None if share is None else True)


def moment(seconds: float) -> UnixTime:
    return UnixTime(1e9 + seconds)


def test_a_flood_begins_with_more_than_ten_in_ten_minutes_and_ends_with_fewer_than_five() -> None:
    rates = AlarmRates()
    for second in range(MANY):
        rates.note(f"alarm-{second}", moment(second))
    assert rates.flood(moment(MANY)) == 0
    rates.note("one more", moment(MANY))
    assert rates.flood(moment(MANY)) == MANY + 1
    still = moment(WINDOW_S + MANY - FEW + 0.5)
    assert rates.flood(still) == FEW
    assert rates.flood(still + 1.0) == 0
    rates.note("later", still + 2.0)
    assert rates.flood(still + 2.0) == 0, "the next flood begins with more than ten, too"


def test_an_alarm_chatters_that_came_three_times_within_a_minute() -> None:
    rates = AlarmRates()
    for second in (0, 30, CHATTERS_S):
        assert not rates.chatters("a", moment(second))
        rates.note("a", moment(second))
    assert rates.chatters("a", moment(CHATTERS_S))
    assert not rates.chatters("b", moment(CHATTERS_S))
    assert not rates.chatters("a", moment(CHATTERS_S + WINDOW_S)), "it was long ago"
    rates.note("a", moment(200))
    assert not rates.chatters("a", moment(200))


@given(st.lists(st.floats(-1e6, 1e6), max_size=40), st.floats(-1e6, 1e6))
def test_whatever_the_clock_does_no_more_are_counted_than_came(times: list[float], now: float) -> None:
    rates = AlarmRates()
    for each in times:
        rates.note("a", moment(each))
    assert 0 <= rates.count(moment(now)) <= len(times)
    assert rates.flood(moment(now)) in (0, rates.count(moment(now)))


RISE = ("rise", "normal", "unack_active")
SEEN = ("acknowledge", "unack_active", "ack_active")
CLEAR = ("clear", "ack_active", "normal")


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


async def test_an_occurrence_keeps_its_times_beyond_the_span(journal: Journal) -> None:
    journal.write("a", (10, *RISE), (15, *SEEN), (40, *CLEAR), (50, *RISE))
    assert await spans(journal, 20, 30) == [("a", 10, 40)]
    assert await spans(journal, 40, 45) == []
    assert await spans(journal, 0, 5) == []
    assert await spans(journal, 45, 60) == [("a", 50, None)]


async def test_what_was_hidden_is_not_marked_until_it_is_annunciated(journal: Journal) -> None:
    journal.write("a", (10, "rise", "suppressed", "suppressed"), (20, "unsuppress", "suppressed", RISE[2]))
    journal.write("b", (10, *RISE), (15, "shelve", "unack_active", "shelved"))
    assert await spans(journal, 0, 60) == [("b", 10, 15), ("a", 20, None)]


async def test_of_too_many_occurrences_the_newest_are_marked(journal: Journal) -> None:
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
        journal.rise(alarm, *(offset / 100 + at for at in range(100)))
    found, steps = await steps_for(journal, 100, *alarms)
    assert found == MAX_OCCURRENCES + 1
    assert steps < 3000, "and 5,000 occurrences were not looked at"


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
def lasting_journal(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Journal]:
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
async def test_figures_leave_out_what_the_clock_made_negative(
    lasting_journal: Journal, several: list[Cycle]
) -> None:
    _, begin = written(lasting_journal, several)
    start, end = UnixTime(T + begin - REACH_S), UnixTime(T + begin + REACH_S)
    lasting_journal.spans = [ObservedSpan(start, end)]
    performance = await measure(lasting_journal.store, [], lasting_journal.spans, start, end)
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
async def test_an_occurrence_never_ends_before_it_began(
    lasting_journal: Journal, several: list[Cycle]
) -> None:
    alarm, begin = written(lasting_journal, several)
    span = UnixTime(T + begin - REACH_S), UnixTime(T + begin + REACH_S)
    found = await occurrences(lasting_journal.store, [alarm], *span)
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
