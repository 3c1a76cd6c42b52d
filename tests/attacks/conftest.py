"""The app with an admin, and two units that respond."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from app.core.web.access import Role
from tests.app.complete_app import House, complete_app
from tests.app.played_line import PlayedLine, played_line


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        await house.add("boss", Role.ADMIN)
        yield house


@pytest.fixture
async def line(house: House) -> PlayedLine:
    return await played_line(house.services)
