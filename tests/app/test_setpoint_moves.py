"""How far a setpoint was moved within a minute."""

from __future__ import annotations

import pytest

from app.commands.rules.setpoint_moves import Moves
from bus.instants import UnixTime


@pytest.fixture
def moves() -> Moves:
    """Unit 1 was moved by 30 at second 100, and by 12 at second 130."""
    noted = Moves()
    noted.note(1, 30, UnixTime(100.0))
    noted.note(1, 12, UnixTime(130.0))
    return noted


@pytest.mark.parametrize(
    ("at", "moved"), [(130.0, 42), (159.9, 42), (160.0, 12), (189.9, 12), (190.0, 0), (1e9, 0)]
)
def test_a_step_counts_for_a_minute(moves: Moves, at: float, moved: int) -> None:
    assert moves.within_a_minute(1, UnixTime(at)) == moved
    assert moves.within_a_minute(1, UnixTime(at)) == moved


def test_each_unit_has_its_own(moves: Moves) -> None:
    assert moves.within_a_minute(2, UnixTime(130.0)) == 0


def test_a_step_that_did_not_happen_counts_no_more(moves: Moves) -> None:
    moves.take_back(1, 30, UnixTime(100.0))
    assert moves.within_a_minute(1, UnixTime(130.0)) == 12


def test_only_the_step_that_was_noted_is_taken_back(moves: Moves) -> None:
    moves.take_back(1, 30, UnixTime(130.0))
    moves.take_back(2, 30, UnixTime(100.0))
    assert moves.within_a_minute(1, UnixTime(130.0)) == 42
