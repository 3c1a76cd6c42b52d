"""The list of sets names 40 units by their first and their last one."""

from __future__ import annotations

import pytest

from app.engineering.sets.pages import unit_ranges

NAMES = {1: "Unwind", 2: "Infeed nip", 4: "Dryer 1", 5: "Dryer 2", 6: "Dryer 3", 7: "Dryer 9", 9: "Rewind"}


@pytest.mark.parametrize(
    ("units", "text"),
    [
        ((), []),
        ((1,), ["1 Unwind"]),
        ((1, 2), ["1-2 Unwind - Infeed nip"]),
        ((6, 4, 5), ["4-6 Dryer 1-3"]),
        ((1, 2, 4, 5, 9), ["1-2 Unwind - Infeed nip", "4-5 Dryer 1-2", "9 Rewind"]),
        ((4, 5, 6, 7), ["4-7 Dryer 1 - Dryer 9"]),
        ((9, 200), ["9 Rewind", "200"]),
        ((199, 200), ["199-200"]),
        (range(1, 10), ["1-9 Unwind - Rewind"]),
    ],
)
def test_neighbors_are_a_range(units: tuple[int, ...], text: list[str]) -> None:
    assert [each.replace("\N{EN DASH}", "-") for each in unit_ranges(units, NAMES)] == text
