"""``lineside report``: what each unit did in a shift, and what people have to know of it, from the stores
alone."""

from __future__ import annotations

import json
import os
import shutil
import signal
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from time import sleep
from typing import Any

import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from app.cli import cli
from app.core.database import Database
from app.line.alarms.journal import JournalEntry, alarm_writer
from app.line.history.report import BusReport, UnitReport
from app.line.history.series.figures import (
    RunFigures,
    RunStretch,
    SpeedStretch,
    draw_figures,
    joined,
    minute_figures,
    passed_web,
    run_figures,
    runs_of_minutes,
    stretches,
)
from app.line.history.series.runs import HOUR, MINUTE, SECOND, Run, merge, plain_run, rollup
from app.line.history.series.values import LinearScale, Marks, Scaling, usual_interval
from app.records.handover.notes import Note
from app.records.handover.notes import add as add_note
from app.records.handover.rules import Shift
from bus.contract import Reading, UnitLink
from bus.instants import UnixTime
from bus.settings import BusSettings, UnitLabels, UnitSettings
from tests.app.history_line import BUS, NOON, Shelf, parameter
from tests.e2e.site import add_people
from tests.for_each import for_each

SHIFT = "2026-11-21T06:00"
"""It has NOON in it."""
RUN, ESTOP_HEALTHY = 1, 2
ON = RUN | ESTOP_HEALTHY
AT_SPEED = 0x8000


def run(at: float, until: float, actual: int, *, commanded: int = 100, inputs: int = ON) -> Run:
    readings = max(1, round((until - at) * 4))
    return Run(round(at * SECOND), round(until * SECOND), readings, commanded, actual, 0, inputs)


def counted_runs(
    runs: Sequence[Run], span: tuple[int, int], marks: Marks, cuts: Sequence[int] = ()
) -> list[RunStretch]:
    table = list(zip(*runs, strict=True)) or [()] * len(Run._fields)
    return stretches(table, span, marks, usual_interval(runs), cuts)


def figures(
    runs: Sequence[Run], start: float = 0, end: float = 100, marks: Marks | None = None
) -> RunFigures:
    counted = counted_runs(runs, (round(start * SECOND), round(end * SECOND)), marks or Marks())
    return run_figures(counted, 1, Scaling([0], [LinearScale(per=10)]))


@given(
    st.lists(
        st.tuples(st.integers(1, 40), st.integers(0, 60), st.sampled_from([0, 50, 51]), st.booleans()),
        min_size=1,
        max_size=40,
    ),
    st.integers(0, 300),
)
def test_the_figures_of_minutes_add_up_to_those_of_the_span(
    steps: list[tuple[int, int, int, bool]], changed: int
) -> None:
    scales = Scaling([0, changed * SECOND], [LinearScale(per=10), LinearScale(per=100)])
    runs, at = [], 0
    for gap, length, actual, is_at_speed in steps:
        at += gap
        until = min(at + length, at // 60 * 60 + 59)
        inputs = ON | (AT_SPEED if is_at_speed else 0)
        runs.append(run(at, until, actual, inputs=inputs))
        at = until
    marks = Marks(lost=[runs[len(runs) // 2].until + SECOND // 2])
    counted = counted_runs(runs, (0, 1 << 60), marks, scales.since)
    total = run_figures(counted, 1, scales)
    minutes = minute_figures(runs, marks, scales)
    assert sum(each.known for each in minutes.values()) == total.known
    assert sum(each.running for each in minutes.values()) == total.running
    assert sum(each.at_speed for each in minutes.values()) == total.at_speed
    assert sum(each.travel for each in minutes.values()) == pytest.approx(total.travel)
    assert all(minute % MINUTE == 0 and each.known <= MINUTE for minute, each in minutes.items())


def test_it_runs_while_its_speed_is_not_zero_and_each_stop_has_its_cause() -> None:
    found = figures(
        [
            run(0, 10, 50),
            run(10.2, 20, 0, inputs=ESTOP_HEALTHY),
            run(20.2, 30, 50),
            run(30.2, 40, 0, inputs=RUN),
            run(40.2, 50, 50),
            run(50.2, 60, 0, commanded=0),
            run(60.2, 70, 50),
            run(70.2, 80, 0),
            run(80.2, 100, 100),
        ]
    )
    assert [stop.cause for stop in found.stops] == ["run_off", "estop", "speed_zero", "unknown"]
    assert [(stop.at / SECOND, stop.until / SECOND) for stop in found.stops] == [
        *((10.2, 20.2), (30.2, 40.2), (50.2, 60.2), (70.2, 80.2))
    ]
    assert found.known == 100 * SECOND
    assert found.running == 60 * SECOND
    assert found.travel == pytest.approx((5 * 40.2 + 10 * 19.8) * SECOND, rel=0.01)


def test_a_hole_is_neither_running_nor_a_stop_and_a_stop_over_it_is_one() -> None:
    found = figures([run(0, 10, 0), run(60, 70, 0), run(70.2, 80, 50)])
    assert (found.known, found.running) == (30 * SECOND, round(9.8 * SECOND))
    assert [(stop.at, stop.until) for stop in found.stops] == [(0, round(70.2 * SECOND))]


@for_each("at", (10, 60))
def test_a_speed_that_swings_about_zero_as_it_comes_to_rest_is_one_stop(at: float) -> None:
    """Also over the end of a minute, where parts are joined."""
    runs = [run(at - 5, at - 0.2, 50), run(at - 0.2, at, 0), run(at, at + 0.2, 1), run(at + 0.2, at + 20, 0)]
    runs.append(run(at + 20.2, at + 30, 50))
    first, second = (figures(runs, *span) for span in ((0, at), (at, 120)))
    for found in (figures(runs, end=120), joined([first, second])):
        assert [(stop.at, stop.until) for stop in found.stops] == [
            (round((at - 0.2) * SECOND), round((at + 20.2) * SECOND))
        ]


def test_readings_outside_of_the_span_do_not_count() -> None:
    found = figures([run(0, 30, 50), run(30.2, 60, 0), run(60.2, 90, 50)], start=10, end=40)
    assert (found.known, found.running) == (30 * SECOND, round(20.2 * SECOND))
    assert [stop.until for stop in found.stops] == [40 * SECOND]


def test_at_speed_is_what_the_unit_reports_while_it_runs_with_a_setpoint() -> None:
    found = figures(
        [
            run(0, 10, 50),
            run(10, 20, 100, inputs=ON | AT_SPEED),
            run(20, 30, 0, commanded=0, inputs=ON | AT_SPEED),
            run(30, 40, 1, commanded=0, inputs=ON | AT_SPEED),
            run(40, 50, 100, inputs=ON | AT_SPEED),
        ]
    )
    assert (found.running, found.at_speed) == (40 * SECOND, 20 * SECOND)
    assert found.fastest == 10.0


def test_a_short_hole_that_the_worker_reported_counts_as_nothing() -> None:
    runs = [run(0, 10, 100, inputs=ON | AT_SPEED), run(15, 20, 100, inputs=ON | AT_SPEED)]
    assert figures(runs).known == 20 * SECOND
    found = figures(runs, marks=Marks(lost=[11 * SECOND], found=[15 * SECOND]))
    assert (found.known, found.running, found.at_speed) == (15 * SECOND,) * 3


@given(
    st.lists(st.tuples(st.integers(1, 200), st.integers(0, 3), st.booleans()), max_size=40),
    st.lists(st.integers(0, 8000), max_size=5),
)
def test_running_and_stops_fill_the_known_time(parts: list[tuple[int, int, bool]], cuts: list[int]) -> None:
    runs, at = [], 0
    for lasting, actual, is_at_speed in parts:
        runs.append(run(at, at + lasting, actual, inputs=ON | (AT_SPEED if is_at_speed else 0)))
        at += lasting
    found = figures(runs, end=10_000)
    assert found.running + sum(stop.until - stop.at for stop in found.stops) == found.known == at * SECOND
    assert 0 <= found.at_speed <= found.running
    edges = [0, *sorted(cuts), 10_000]
    whole = joined(figures(runs, start, end) for start, end in pairwise(edges))
    for name in ("known", "running", "at_speed", "fastest", "stops"):
        assert getattr(whole, name) == getattr(found, name), "spans add up"
    assert whole.travel == pytest.approx(found.travel)


@given(
    st.lists(st.tuples(st.integers(1, 100), st.integers(1, 50)), min_size=1, max_size=20), st.floats(0.5, 2.0)
)
def test_a_draw_is_of_the_web_that_passed_whatever_the_pieces(
    parts: list[tuple[int, int]], ratio: float
) -> None:
    before, at = [], 0
    for lasting, speed in parts:
        before.append(SpeedStretch(at * SECOND, (at + lasting) * SECOND, speed))
        at += lasting
    section = [each._replace(speed=each.speed * ratio) for each in before]
    found = draw_figures([passed_web(before[:5], section[:5]), None, passed_web(before[5:], section[5:])])
    assert found is not None
    assert found == pytest.approx([100 * (ratio - 1)] * 3, abs=0.011)
    assert found.least <= found.average <= found.greatest
    later = [each._replace(at=each.at + at * SECOND, until=each.until + at * SECOND) for each in section]
    assert passed_web(before, later) is None, "at no time both have a speed"


def test_minutes_whose_readings_are_given_up_count_as_minutes() -> None:
    moved, stood = run(0, 59, 50), run(60, 119, 0, inputs=ESTOP_HEALTHY)
    runs = runs_of_minutes([rollup([moved], 0), rollup([stood], MINUTE)])
    found = figures(runs, end=120)
    assert (found.known, found.running) == (120 * SECOND, 60 * SECOND)
    assert [stop.cause for stop in found.stops] == ["run_off"]


TWO = BusSettings(
    name=BUS.name,
    port=BUS.port,
    unit=tuple(UnitSettings(id=each, name=str(each), labels=UnitLabels(unit="m/min")) for each in (1, 2)),
)
BEGAN = NOON - 900
"""The readings of a history are in the blocks of three hours."""


def history_of(parts: Sequence[tuple[int, int, int, int]]) -> list[Reading]:
    """Return a reading a second of two units, which do the same, the second one a little faster."""
    kept, at = [], BEGAN
    for lasting, actual, inputs, gap in parts:
        outputs = 0xC0 if actual == 100 else 0x40
        for step in range(lasting):
            for unit in (1, 2):
                speed = actual + unit * (actual > 0)
                kept.append(Reading(unit, UnixTime(at + step), 100, speed, 0, outputs, inputs))
        at += lasting + gap
    return kept


def stored_history(folder: Path, readings: Sequence[Reading], state: str) -> Shelf:
    """Return a store of a history: in its journal, in minutes, in packed hours, or with figures."""
    shelf = Shelf(folder / "history.db")
    shelf.keep([parameter(3, 1, unit=unit) for unit in (1, 2)])
    shelf.keep(readings)
    if state != "journal":
        shelf.fold()
    if state in ("packed", "worked out"):
        shelf.pack()
    if state == "worked out":
        shelf.work_out(TWO)
    return shelf


def read_units(shelf: Shelf, span: tuple[int, int]) -> list[UnitReport]:
    report = BusReport(TWO, None, span)
    return [shelf.database.read_now(lambda c, unit=unit: report.read(c, shelf.tail, unit)) for unit in (1, 2)]  # type: ignore[misc]


@settings(max_examples=settings.default.max_examples // 3)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([20, 61, 300, 1500]),
            st.sampled_from([0, 0, 55, 100]),
            st.sampled_from([ON, RUN]),
            st.sampled_from([0, 0, 3, 30, 200]),
        ),
        min_size=1,
        max_size=8,
    ),
    st.integers(0, 1200),
    st.integers(1200, 9000),
    st.sampled_from(["journal", "minutes", "packed", "worked out", "worked out"]),
)
def test_stored_figures_and_minutes_and_readings_of_the_others_give_the_figures_of_all_readings(
    tmp_path_factory: pytest.TempPathFactory,
    parts: list[tuple[int, int, int, int]],
    begin: int,
    end: int,
    state: str,
) -> None:
    readings = history_of(parts)
    shelf = stored_history(tmp_path_factory.mktemp("history"), readings, state)
    span = round(BEGAN + begin) * SECOND, round(BEGAN + end) * SECOND
    found = read_units(shelf, span)
    shelf.close()
    speeds = []
    for unit in found:
        runs = merge((), (plain_run(each) for each in readings if each.unit == unit.unit))
        counted = counted_runs(runs, span, Marks())
        exact = run_figures(counted, 1, Scaling([0], [LinearScale(per=10)]))
        speeds.append(
            [SpeedStretch(each.at, each.until, each.actual) for each in counted if each.is_at_speed]
        )
        assert unit.runs is not None
        for name in ("known", "running", "at_speed", "fastest", "stops", "by_minute"):
            assert getattr(unit.runs, name) == getattr(exact, name), name
        assert unit.runs.travel == pytest.approx(exact.travel)
    assert found[1].draw == draw_figures([passed_web(*speeds)])


def test_late_readings_marks_other_scales_and_damage_undo_stored_figures(tmp_path: Path) -> None:
    shelf = stored_history(tmp_path, history_of([(2700, 100, ON, 60), (6000, 100, ON, 0)]), "worked out")
    hour = round(NOON) * SECOND
    span = hour, hour + HOUR

    def stored() -> set[tuple[int, int]]:
        query = "SELECT unit, (start - ?) / 3600000000 FROM figures"
        return {(unit, at) for unit, at in shelf.database.read_now(lambda c: list(c.execute(query, (hour,))))}

    every = {(unit, at) for unit in (1, 2) for at in (-1, 0, 1, 2)}
    assert stored() == every
    late = (UnixTime(NOON + 1800 + second) for second in range(60))
    shelf.keep([Reading(1, at, 100, 0, 0, 0x40, ON) for at in late])
    assert stored() == every
    read_at_once = read_units(shelf, span)
    shelf.fold()
    assert stored() == {(1, 2), (2, 2)}, "of the hour and those beside it, of both units, as a draw is"
    shelf.work_out(TWO)
    assert stored() == every
    [first, second] = read_units(shelf, span)
    assert [first, second] == read_at_once, "also before they were in their blocks"
    assert first.runs is not None
    assert (len(first.runs.stops), first.runs.fastest) == (1, 10.1)
    damage = "UPDATE figures SET data = CAST(replace(CAST(data AS TEXT), '10.1', '90.1') AS BLOB)"
    assert shelf.database.write_now(lambda c: c.execute(damage).rowcount) == len(every)
    assert read_units(shelf, span) == [first, second], "damaged ones are not used"
    shelf.work_out(TWO)
    shelf.keep([parameter(3, 2, BEGAN)])
    [first, _] = read_units(shelf, span)
    assert first.runs is not None
    assert first.runs.fastest == 1.01, "of the scale of before they are not used"
    shelf.keep([UnitLink(unit=2, at=UnixTime(NOON + 3660), link="offline")])
    assert stored() == {(1, -1), (2, -1), (1, 2), (2, 2)}
    shelf.close()


LATE_STOPS = 4


def with_holes() -> list[Reading]:
    """Return the readings of some minutes without those of some stops of 10 s."""
    return history_of([(50, 100, ON, 10)] * LATE_STOPS + [(50, 100, ON, 0)])


def late_stop(number: int) -> list[Reading]:
    """Return the readings of one of the stops."""
    began = BEGAN + 50 + 60 * number
    return [Reading(1, UnixTime(began + second), 100, 0, 0, 0x40, ON) for second in range(10)]


def stops_read(shelf: Shelf) -> int:
    [first, _] = read_units(shelf, (round(NOON) * SECOND - HOUR, round(NOON) * SECOND))
    assert first.runs is not None
    return len(first.runs.stops)


def test_a_report_that_is_read_while_late_readings_come_has_all_that_came_before(tmp_path: Path) -> None:
    shelf = stored_history(tmp_path, with_holes(), "worked out")
    begun, done, found = [0], [0], list[tuple[int, int, int]]()

    def read() -> None:
        while done[0] < LATE_STOPS:
            before = done[0]
            stops = stops_read(shelf)
            found.append((before, stops, begun[0]))

    with ThreadPoolExecutor(1) as thread:
        reading = thread.submit(read)
        for number in range(LATE_STOPS):
            count = len(found)
            while len(found) < count + 2:
                sleep(0.001)
            begun[0] += 1
            shelf.keep(late_stop(number))
            done[0] += 1
            shelf.fold()
            shelf.work_out(TWO)
        reading.result()
    assert all(before <= stops <= after for before, stops, after in found), found
    assert stops_read(shelf) == LATE_STOPS
    shelf.close()


def test_a_kill_at_any_statement_leaves_no_wrong_figures(tmp_path: Path) -> None:
    stored_history(tmp_path, with_holes(), "worked out").close()

    def change(path: Path, statements: list[str], killed_at: int) -> None:
        shelf = Shelf(path)

        def note(statement: str) -> None:
            statements.append(statement)
            if len(statements) == killed_at:
                os.kill(os.getpid(), signal.SIGKILL)

        shelf.database.write_now(lambda connection: connection.set_trace_callback(note))
        shelf.keep(late_stop(0))
        shelf.fold()
        shelf.work_out(TWO)

    def copied(number: int) -> Path:
        path = tmp_path / f"{number}.db"
        shutil.copy(tmp_path / "history.db", path)
        return path

    statements: list[str] = []
    change(copied(0), statements, 0)
    ends = [place for place, text in enumerate(statements, 1) if "figures" in text or text == "COMMIT"]
    for number in ends[:: max(1, len(ends) // 6)]:
        path = copied(number)
        process = get_context("fork").Process(target=change, args=(path, [], number))
        process.start()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        shelf = Shelf(path)
        found = stops_read(shelf)
        shelf.database.write_now(lambda connection: connection.execute("DELETE FROM figures"))
        assert found == stops_read(shelf), statements[number - 1]
        shelf.close()


CONFIGURATION = """\
[site]
name = "Mill"
time_zone = "UTC"
[server]
data = "data"
[[bus]]
name = "dry-end"
port = "/dev/ttyUSB0"
[[bus.unit]]
id = 1
name = "Unwind"
[bus.unit.labels]
unit = "m/min"
[[bus.unit]]
id = 2
name = "Rewind"
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "lineside.toml"
    path.write_text(CONFIGURATION)
    add_people(path)
    return path


def unit_reading(at: float, actual: int) -> Reading:
    return Reading(unit=1, at=UnixTime(at), commanded=actual, actual=actual, analog=0, outputs=0, inputs=ON)


def called(config: Path, *more: str) -> Result:
    return CliRunner().invoke(cli, ["report", "--config", str(config), *more])


def report_of(config: Path, *more: str) -> dict[str, Any]:
    done = called(config, "--json", *more)
    assert done.exit_code == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_a_shift_has_the_run_time_stops_and_length_of_each_unit(config: Path) -> None:
    shelf = Shelf(config.parent / "data" / "history.db")
    shelf.keep([unit_reading(NOON + second / 4, 60 if second < 1200 else 0) for second in range(2400)])
    shelf.close()
    before = {path: path.read_bytes() for path in sorted(config.parent.rglob("*")) if path.is_file()}
    found = report_of(config, "--shift", SHIFT)
    assert {path: path.read_bytes() for path in sorted(config.parent.rglob("*")) if path.is_file()} == before
    unwind, rewind = found["units"]
    assert (unwind["name"], unwind["known_s"], unwind["running_s"]) == ("Unwind", 599.75, 300.0)
    [stop] = unwind["stops"]
    assert (stop["seconds"], stop["cause"]) == (299.75, "speed_zero")
    assert (unwind["length"], unwind["length_unit"]) == (300.0, "m")
    assert (rewind["known_s"], rewind["length"]) == (0, None)
    shown = called(config, "--shift", SHIFT)
    assert shown.exit_code == 0
    assert "dry-end/1 Unwind: ran 0:05:00 of 0:10:00, 1 stop, 300.0 m" in shown.stdout
    assert "0:05:00: commanded speed 0" in shown.stdout


def test_any_span_has_the_same_report_and_its_units_as_csv(config: Path) -> None:
    shelf = Shelf(config.parent / "data" / "history.db")
    shelf.keep([unit_reading(NOON + second / 4, 60 if second < 1200 else 0) for second in range(2400)])
    shelf.close()
    span = ("--since", "2026-11-20T06:00", "--until", "2026-11-22T06:00")
    found = report_of(config, *span)
    assert (found["start"][:16], found["end"][:16]) == ("2026-11-20T06:00", "2026-11-22T06:00")
    assert (found["units"][0]["running_s"], found["signed"]) == (300.0, None)
    assert "Mill: 2026-11-20 06:00 to 2026-11-22 06:00 (UTC)" in called(config, *span).stdout
    head, unwind, rewind = called(config, "--csv", *span).stdout.splitlines()
    assert head.startswith("bus,unit,name,start,end,known_s,running_s,length,length_unit,stops,stopped_s,")
    assert unwind.startswith("dry-end,1,Unwind,2026-11-20T06:00")
    assert ",599.75,300.0,300.0,m,1,299.75,0.0,172200.25,60.0,60.0,m/min," in unwind
    assert ",0.0,0.0,,,0,0.0," in rewind
    head, stop = called(config, "--stops", *span).stdout.splitlines()
    assert head == "bus,unit,name,began,ended,seconds,reason,before,goes_on"
    assert stop.startswith(
        "dry-end,1,Unwind,2026-11-21T12:05:00.000+00:00,2026-11-21T12:09:59.750+00:00,299.75"
    )
    assert stop.endswith(",speed_zero,False,True")


@pytest.mark.parametrize(
    ("span", "reason"),
    [
        (("--until", "2026-11-22T06:00"), "a span begins before now"),
        (("--since", "2026-11-22T06:00", "--until", "2026-11-22T06:00"), "a span begins before now"),
        (("--since", "monday"), "'monday' is no"),
    ],
)
def test_a_span_that_is_none_is_wrong_use(config: Path, span: tuple[str, ...], reason: str) -> None:
    done = called(config, *span)
    assert (done.exit_code, reason in done.stderr) == (2, True), done.stderr


def test_without_history_there_are_the_events(config: Path) -> None:
    found = report_of(config, "--shift", "now")
    assert (found["site"], found["units"], found["alarms"], found["notes"]) == ("Mill", [], [], [])
    assert found["omissions"]
    assert "0 alarms came" in called(config, "--shift", "now").stdout
    assert report_of(config)["end"] == found["start"], "without a name it is the last that ended"


@pytest.mark.parametrize(
    ("shift", "reason"),
    [
        ("yesterday", "is no time"),
        ("2026-01-01T06:30", "No shift starts at 2026-01-01 06:30"),
        ("2999-01-01T06:00", "has not begun"),
    ],
)
def test_a_shift_that_is_none_is_wrong_use(config: Path, shift: str, reason: str) -> None:
    done = called(config, "--shift", shift)
    assert (done.exit_code, reason in done.stderr) == (2, True), done.stderr


def test_it_has_the_alarms_that_came_changes_and_notes(config: Path) -> None:
    came = JournalEntry(
        alarm="dry-end.1.unit_offline",
        code="unit_offline",
        name="Unit is offline",
        bus="dry-end",
        unit=1,
        occurrence=1,
        priority="high",
        at=UnixTime(NOON),
        trigger="rise",
        before="normal",
        after="unack_active",
    )
    later = replace(came, at=UnixTime(NOON + 9000), occurrence=2)
    shift = Shift(UnixTime(NOON - 21_600), UnixTime(NOON + 7200))
    note = Note(UnixTime(NOON), UnixTime(NOON), "anna", "Belt is new", "dry-end", 1, None, None, "anna", None)
    with closing(Database(config.parent / "data" / "lineside.db")) as database:
        database.write_now(alarm_writer([came, later], []))
        database.write_now(lambda store: add_note(store, note, shift))
    found = report_of(config, "--shift", SHIFT)
    assert [(each["code"], each["unit"]) for each in found["alarms"]] == [("unit_offline", 1)]
    assert [each["text"] for each in found["notes"]] == ["Belt is new"]
    shown = called(config, "--shift", SHIFT).stdout
    assert "  12:00 dry-end/1 Unit is offline (high)" in shown
    assert "  12:00 anna: Belt is new" in shown
    changes = [line for line in called(config, "--shift", "now").stdout.splitlines() if "change" in line]
    assert changes == ["0 changes"], "users and tokens are in the audit log"
