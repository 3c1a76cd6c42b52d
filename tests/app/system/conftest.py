"""A database of the plant that no other test has."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.postgresql import fresh_database


@pytest.fixture
def database() -> Iterator[str]:
    with fresh_database() as url:
        yield url
