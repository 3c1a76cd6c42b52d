"""The login with a company account at a real provider: the package oidc-provider, run by Node."""

from __future__ import annotations

import asyncio
import re
import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import urljoin

import httpx
import pytest

from app.people.auth.pages import ATTEMPT_COOKIE
from app.people.auth.settings import OidcSettings
from tests.app.complete_app import HOST, House, complete_app
from tests.app.played_provider import CALLBACK, CLIENT, GROUPS, SECRET, known, reason_of, sent

ROOT = Path(__file__).resolve().parents[3]
PROVIDER = Path(__file__).parents[1] / "oidc_provider.mjs"


@pytest.fixture
async def issuer() -> AsyncIterator[str]:
    node = shutil.which("node")
    if node is None or not (ROOT / "node_modules" / "oidc-provider").exists():
        pytest.skip("the provider is a package of Node, which make development installs")
    process = await asyncio.create_subprocess_exec(
        *(node, str(PROVIDER), CLIENT, SECRET, f"http://{HOST}{CALLBACK}"),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    assert process.stdout is not None
    async with asyncio.timeout(60):
        yield (await process.stdout.readline()).decode().strip()
    process.kill()
    await process.communicate()


@pytest.fixture
async def house(tmp_path: Path, issuer: str) -> AsyncIterator[House]:
    secret = tmp_path / "oidc.secret"
    secret.write_text(SECRET)
    settings = OidcSettings(issuer=issuer, client_id=CLIENT, client_secret_file=secret, roles=GROUPS)
    async with complete_app(tmp_path, oidc=settings) as house:
        await known(house)
        yield house


async def authenticated(there: httpx.AsyncClient, url: str, login: str) -> str:
    """Log in at the provider and agree to what the client requests. Returns where it sends the browser."""
    response = await there.get(url)
    for _ in range(20):
        while response.is_redirect:
            url = urljoin(str(response.url), response.headers["location"])
            if url.startswith(f"http://{HOST}"):
                return url
            response = await there.get(url)
        action = re.search(r'<form[^>]* action="([^"]+)"', response.text)
        assert action is not None, response.text
        hidden = dict(re.findall(r'type="hidden" name="(\w+)" value="([^"]*)"', response.text))
        form = {**hidden, "login": login, "password": "any"}
        response = await there.post(urljoin(str(response.url), action[1]), data=form)
    raise AssertionError("the provider has sent the browser round in circles")


async def test_a_person_logs_in_at_a_real_provider(house: House) -> None:
    browser = house.client()
    async with httpx.AsyncClient() as there:
        back = await authenticated(there, await sent(browser, "/events"), "anna+line-operators")
        response = await browser.get(back)
        assert (response.status_code, response.headers["location"]) == (303, "/events")
        me = (await browser.get("/api/v1/me")).json()
        assert me == {"name": "anna", "role": "operator", "via": "session"}

        # The provider knows the person still, and requests the password only after a log-out here.
        other = house.client()
        url = await sent(other)
        without_password = await there.get(url)
        assert without_password.headers["location"].startswith(f"http://{HOST}{CALLBACK}?code=")
        await browser.post("/logout")
        url = await sent(browser)
        again = await there.get(url)
        assert "/interaction/" in again.headers["location"]
        back = await authenticated(there, url, "ben+line-admins")
        await browser.get(back)
        assert (await browser.get("/api/v1/me")).json()["role"] == "admin"

    # The code of a response is taken once, and only from the browser that it is for.
    stranger = house.client()
    assert reason_of(await stranger.get(back)) == "expired"
    async with httpx.AsyncClient() as there:
        back = await authenticated(there, await sent(stranger), "carl+visitors")
        attempt = stranger.cookies[ATTEMPT_COOKIE]
        assert reason_of(await stranger.get(back)) == "groups"
        stranger.cookies.set(ATTEMPT_COOKIE, attempt, domain=HOST)
        assert reason_of(await stranger.get(back)) == "provider"
