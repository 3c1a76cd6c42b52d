"""An app with two units, and its engineer."""

from __future__ import annotations

import httpx
import pytest

from app.core.web.access import Role
from tests.app.complete_app import House


@pytest.fixture
async def client(house: House) -> httpx.AsyncClient:
    return await house.signed_in(Role.ENGINEER)
