"""The draw over time, made of the stored actual speeds of two units."""

from __future__ import annotations

from pathlib import Path

from app.line.history.query import SeriesQuery, run_query, stored_queries
from app.line.history.series.downsampling import Series
from app.line.history.series.figures import draw_series
from app.line.history.series.runs import SECOND, micros
from app.line.history.series.values import LONG_GAP, VALUES
from bus.settings import BusSettings, UnitSettings
from tests.app.history_line import BUS, NOON, Shelf, parameter, reading

PAIR = BusSettings(
    name=BUS.name, port=BUS.port, unit=(UnitSettings(id=7, name="Nip"), UnitSettings(id=1, name="Rewind"))
)


def speeds(*points: tuple[int, float | None]) -> Series:
    at, values = [time * SECOND for time, _ in points], [value for _, value in points]
    return Series(at, values, list(values), list(values))


def made(before: Series, section: Series, width: int = 0) -> list[tuple[float, float | None]]:
    found = draw_series(before, section, width * SECOND)
    assert found.least == found.greatest == found.average
    return [(at / SECOND, draw) for at, draw in zip(found.at, found.average, strict=True)]


def test_each_speed_is_held_until_its_next_point() -> None:
    before = speeds((0, 100.0), (10, 100.0), (11, 101.0))
    section = speeds((1, 102.0), (20, 102.0))
    assert made(before, section) == [(0, None), (1, 2.0), (10, 2.0), (11, 0.99), (20, 0.99)]


def test_a_hole_or_a_standstill_of_either_is_a_hole() -> None:
    before = speeds((0, 100.0), (5, None), (9, 100.0), (12, 0.0))
    section = speeds((0, 101.0), (6, 101.0), (10, 101.0), (13, 101.0))
    assert [draw for _, draw in made(before, section)] == [1.0, None, None, 1.0, 1.0, None, None]


def test_after_its_last_point_a_speed_is_not_held_for_long() -> None:
    late = LONG_GAP // SECOND + 1
    assert made(speeds((0, 100.0)), speeds((0, 101.0), (late, 101.0))) == [(0, 1.0), (late, None)]
    assert made(speeds((0, 100.0)), speeds((0, 101.0), (late, 101.0)), 60)[1] == (late, 1.0)


def test_the_store_gives_readings_or_stretches_of_both_units(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path / "history.db")
    shelf.keep([parameter(3, 1, unit=unit) for unit in (1, 7)])
    seconds = range(300)
    shelf.keep([reading(NOON + at, 1000, unit=7) for at in seconds])
    shelf.keep([reading(NOON + at + 0.5, 1020 + at % 2, unit=1) for at in seconds])
    try:
        for most in (2000, 20):
            query = SeriesQuery(PAIR, 1, VALUES["draw"], micros(NOON), micros(NOON + 300), most)
            found = shelf.database.read_now(lambda c, query=query: run_query(c, shelf.tail, query))
            draws = [draw for draw in found.series.average[1:] if draw is not None]
            assert len(found.series.at) <= most
            assert draws
            assert all(2.0 <= draw <= 2.1 for draw in draws)
            assert found.decimals == 2
    finally:
        shelf.close()


def test_a_draw_is_stored_as_two_speeds() -> None:
    query = SeriesQuery(PAIR, 1, VALUES["draw"], 0, 1, 10)
    assert [(each.unit, each.value.name) for each in stored_queries(query)] == [(7, "actual"), (1, "actual")]
