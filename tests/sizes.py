"""The sizes of a test that takes long: ``make test`` runs the smallest, ``make soak`` the long ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest


def sizes(smallest: Any, *long: Any) -> list[Any]:
    """The values of a parameter, for ``pytest.mark.parametrize``."""
    soak = ((value if isinstance(value, tuple) else (value,)) for value in long)
    return [smallest, *(pytest.param(*values, marks=pytest.mark.soak) for values in soak)]


def in_turn(values: Sequence[Any], others: Sequence[Any], *, first: int | None = None) -> list[Any]:
    """Every pair of both, for the parameters of a walk that takes long: ``make test`` has each value once,
    with the others in turn, or of the ``first`` values only; ``make soak`` the pairs that are left."""
    brief = range(len(values) if first is None else first)
    return [
        pytest.param(
            value,
            other,
            marks=[pytest.mark.soak] * (number not in brief or other != others[number % len(others)]),
        )
        for number, value in enumerate(values)
        for other in others
    ]
