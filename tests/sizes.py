"""The sizes of a test that takes long: ``make test`` runs the smallest, ``make soak`` the long ones."""

from __future__ import annotations

from typing import Any

import pytest


def sizes(smallest: Any, *long: Any) -> list[Any]:
    """The values of a parameter, for ``pytest.mark.parametrize``."""
    soak = ((value if isinstance(value, tuple) else (value,)) for value in long)
    return [smallest, *(pytest.param(*values, marks=pytest.mark.soak) for values in soak)]
