"""The rows of an export as a table for people: one row a time, in which every value is filled in. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from app.history.export_rows import Cell, ExportRow
from app.history.series.runs import MINUTE, SECOND

STEPS = (SECOND, 5 * SECOND, 15 * SECOND, MINUTE)
MAX_ROWS = 100_000
"""More of them, and the step is a longer one; the longest takes any number."""


def step_of(start: int, end: int) -> int:
    """The distance of two rows over a span, µs."""
    return next((step for step in STEPS if (end - start) / step <= MAX_ROWS), STEPS[-1])


class Together:
    """Brings rows of single readings onto a common time, piece by piece: each value holds from its reading
    until the next one, or until the hole after it, however long it is steady."""

    def __init__(self, width: int, step: int) -> None:
        self._step = step
        self._cells: list[Cell | None] = [None] * width
        self._next: int | None = None

    def rows(self, rows: Iterable[ExportRow]) -> Iterator[ExportRow]:
        """The rows at each step up to the last of these."""
        for row in rows:
            yield from self._until(row.at)
            if self._next is None:
                self._next = -(-row.at // self._step) * self._step
            self._take(row)

    def end(self, end: int) -> Iterator[ExportRow]:
        """The row that is left after the last piece, where it is before the end."""
        if self._next is not None:
            yield from self._until(min(end, self._next + 1))

    def _take(self, row: ExportRow) -> None:
        for place, cell in enumerate(row.cells):
            if cell is not None:
                self._cells[place] = cell
        for place in row.ends:
            self._cells[place] = None

    def _until(self, at: int) -> Iterator[ExportRow]:
        while self._next is not None and self._next < at:
            cells = tuple(self._cells)
            if any(cell is not None for cell in cells):
                yield ExportRow(self._next, cells)
                self._next += self._step
            else:
                # Nothing is known until the next reading.
                self._next = -(-at // self._step) * self._step
                return
