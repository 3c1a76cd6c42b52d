"""Languages: one file each, chosen by the person, then the browser, then the site."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from app.core.messages import Languages
from app.core.web.access import Role
from tests.app.complete_app import House, complete_app


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        yield house


@pytest.mark.parametrize(
    ("requested", "accepted", "otherwise", "chosen"),
    [
        ("", "", "en", "en"),
        ("", "", "de", "de"),
        ("", "de-AT,de;q=0.9,en;q=0.8", "en", "de"),
        ("", "fr,en;q=0.5,de;q=0.9", "en", "de"),
        ("", "fr", "de", "de"),
        ("", "DE", "en", "de"),
        ("", "de;q=nonsense, ,;;q=", "en", "en"),
        ("en", "de", "de", "en"),
        ("xx", "de", "en", "de"),
    ],
)
def test_which_language(requested: str, accepted: str, otherwise: str, chosen: str) -> None:
    assert Languages().choose(requested, accepted, otherwise).tag == chosen


async def test_the_browsers_language_and_then_ones_own(house: House) -> None:
    german = {"accept-language": "de"}
    client = await house.signed_in(Role.VIEWER)
    assert '<html lang="de"' in (await client.get("/account", headers=german)).text
    await client.post("/account/language", data={"language": "en"})
    assert '<html lang="en"' in (await client.get("/account", headers=german)).text
    await client.post("/account/language", data={"language": ""})
    assert '<html lang="de"' in (await client.get("/account", headers=german)).text


async def test_a_language_that_is_not_there(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    response: httpx.Response = await client.post("/account/language", data={"language": "../x"})
    assert response.status_code == 422
