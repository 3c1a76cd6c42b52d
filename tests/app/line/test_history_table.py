"""One row a time: every value that is in force then, and none after a hole."""

from __future__ import annotations

from app.line.history.export_rows import MAX_ROWS, STEPS, Cell, ExportRow, Together, step_of
from app.line.history.series.runs import DAY, SECOND

S = SECOND


def row(seconds: float, *values: float | None, ends: tuple[int, ...] = ()) -> ExportRow:
    cells = tuple(None if value is None else Cell(value, 0) for value in values)
    return ExportRow(round(seconds * S), cells, "", ends)


def together(*pieces: list[ExportRow], end: float = 100) -> list[tuple[float, list[float | None]]]:
    table = Together(2, S)
    rows = [each for piece in pieces for each in table.rows(piece)] + list(table.end(round(end * S)))
    return [(row.at / S, [cell and cell.value for cell in row.cells]) for row in rows]


def test_units_that_respond_at_different_times_share_rows() -> None:
    assert together([row(1.2, 10, None), row(1.4, None, 7), row(2.1, 11, None), row(2.3, None, 8)]) == [
        (2, [10, 7]),
        (3, [11, 8]),
    ]


def test_a_reading_at_the_time_itself_counts_and_a_steady_value_holds_over_pieces() -> None:
    assert together([row(1, 10, 7)], [row(3, 11, 7)]) == [(1, [10, 7]), (2, [10, 7]), (3, [11, 7])]


def test_a_hole_ends_the_values_of_its_unit_alone() -> None:
    found = together([row(1, 10, 7), row(1.5, None, None, ends=(0,)), row(3, None, 8), row(4, 12, 8)])
    assert found == [(1, [10, 7]), (2, [None, 7]), (3, [None, 8]), (4, [12, 8])]


def test_a_time_at_which_nothing_is_known_has_no_row() -> None:
    found = together([row(1, 10, 7), row(1.5, None, None, ends=(0, 1)), row(900.5, 12, 8)], end=1000)
    assert found == [(1, [10, 7]), (901, [12, 8])]


def test_nothing_follows_the_end() -> None:
    assert together([row(1.5, 10, 7)], end=1.8) == []
    assert together([]) == []


def test_a_long_span_has_a_longer_step() -> None:
    assert step_of(0, 3600 * S) == S
    assert step_of(0, 3 * DAY) == 5 * S
    assert step_of(0, 3650 * DAY) == STEPS[-1]
    assert 3 * DAY / step_of(0, 3 * DAY) <= MAX_ROWS
