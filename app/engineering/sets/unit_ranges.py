"""Units in as few words as possible: of 40 neighbors the first and the last one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

TO = "\N{EN DASH}"


def unit_ranges(units: Iterable[int], names: Mapping[int, str]) -> list[str]:
    """``["1 Unwind", "4-11 Dryer 1-8"]``, with longer dashes; of a removed unit the address."""
    return [_range_text(first, last, names) for first, last in _ranges(sorted(units))]


def _ranges(units: list[int]) -> Iterator[tuple[int, int]]:
    """First and last of each run of addresses."""
    starts = [unit for at, unit in enumerate(units) if at == 0 or units[at - 1] != unit - 1]
    ends = [unit for at, unit in enumerate(units) if at == len(units) - 1 or units[at + 1] != unit + 1]
    return zip(starts, ends, strict=True)


def _range_text(first: int, last: int, names: Mapping[int, str]) -> str:
    begin, end = names.get(first, ""), names.get(last, "")
    if first == last:
        return f"{first} {begin}".strip()
    return f"{first}{TO}{last} {_joined(begin, end, last - first)}".strip()


def _joined(begin: str, end: str, apart: int) -> str:
    """Of two names whose numbers are as far apart as their addresses, the words once."""
    if not begin or not end:
        return ""
    (word, _, low), (other, _, high) = begin.rpartition(" "), end.rpartition(" ")
    numbered = word == other and low.isdecimal() and high.isdecimal() and int(high) - int(low) == apart
    return f"{begin}{TO}{high}" if numbered else f"{begin} {TO} {end}"
