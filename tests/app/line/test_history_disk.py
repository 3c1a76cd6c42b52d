"""What so many free bytes mean."""

from __future__ import annotations

import pytest

from app.line.history.status import DiskReserve, StoreState, space

RESERVE = DiskReserve(announce=1000, trim=500, pause=100)


@pytest.mark.parametrize(
    ("free", "meaning"),
    [
        (5000, "ok"),
        (1000, "ok"),
        (999, "low"),
        (500, "low"),
        (499, "scarce"),
        (99, "paused"),
        (0, "paused"),
    ],
)
def test_less_space_means_more(free: int, meaning: StoreState) -> None:
    assert space(free, RESERVE) == meaning
