"""Tables in plain text, and the figures that stand in them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[object]], note: str = "") -> None:
    """Print one table, first column to the left, the others to the right."""
    lines = [list(header), *[[str(cell) for cell in row] for row in rows]]
    widths = [max(len(line[column]) for line in lines) for column in range(len(header))]
    print(f"\n{title}\n")
    for place, line in enumerate(lines):
        first, *others = (
            cell.ljust(width) if not column else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        print("  " + "  ".join([first, *others]).rstrip())
        if place == 0:
            print("  " + "  ".join("-" * width for width in widths))
    if note:
        print(f"\n  {note}")
    print(flush=True)


def quantile(values: Sequence[float], part: float) -> float:
    """The value below which ``part`` of the others lie; nan of nothing."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))] if ordered else math.nan


def median(values: Sequence[float]) -> float:
    """nan of nothing."""
    return statistics.median(values) if values else math.nan


def milliseconds(seconds: float) -> str:
    """With as many digits as matter."""
    value = seconds * 1000
    return f"{value:.2f} ms" if abs(value) < 10 else f"{value:.0f} ms"


def microseconds(seconds: float) -> str:
    return f"{seconds * 1e6:.0f} µs"
