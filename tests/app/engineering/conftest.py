"""An app with two units, and its engineer."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from app.core.web.access import Role
from tests.app.complete_app import House, complete_app


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        yield house


@pytest.fixture
async def client(house: House) -> httpx.AsyncClient:
    return await house.signed_in(Role.ENGINEER)
