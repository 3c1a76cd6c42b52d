"""What so many free bytes mean."""

from __future__ import annotations

import pytest

from app.history.intake.upkeep import DiskReserve, Space, space

RESERVE = DiskReserve(announce=1000, trim=500, pause=100)


@pytest.mark.parametrize(
    ("free", "meaning"),
    [
        (5000, "enough"),
        (1000, "enough"),
        (999, "low"),
        (500, "low"),
        (499, "scarce"),
        (99, "none"),
        (0, "none"),
    ],
)
def test_less_space_means_more(free: int, meaning: Space) -> None:
    assert space(free, RESERVE) == meaning
