"""A program on the server's own computer pretends to be a proxy: no address it makes up reaches the log."""

from __future__ import annotations

import asyncio
import socket
from ipaddress import ip_network
from pathlib import Path

import httpx
import pytest

from app.cli.server import Server
from app.core.server.addresses import Network
from app.core.web.access import Role
from app.people.audit.log import EventLog, Filter
from app.people.auth.accounts import Accounts
from bus.instants import monotonic_now
from tests.administrator import BY
from tests.app.complete_app import PASSWORD, settings_in

MADE_UP = {
    "X-Forwarded-For": "198.51.100.9",
    "X-Forwarded-Proto": "https",
    "X-Real-IP": "198.51.100.9",
    "Forwarded": "for=198.51.100.9;proto=https",
}


@pytest.mark.parametrize(
    ("trusted", "origin", "is_https"),
    [((), "127.0.0.1", False), ((ip_network("127.0.0.1"),), "198.51.100.9", True)],
)
async def test_only_a_proxy_that_is_named_is_believed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    trusted: tuple[Network, ...],
    origin: str,
    is_https: bool,
) -> None:
    """The HTTP server itself believed this computer, and whatever its environment named."""
    monkeypatch.setenv("FORWARDED_ALLOW_IPS", "*")
    settings, serving = settings_in(tmp_path), asyncio.Event()
    proxied = settings.server.model_copy(update={"trusted_proxies": trusted})
    settings = settings.model_copy(update={"server": proxied})
    server = Server(settings, False, {}, lambda _code: serving.set(), monotonic_now())
    services = server.services
    with socket.create_server(("127.0.0.1", 0)) as listening:
        task = asyncio.create_task(server.serve([listening]))
        await asyncio.wait_for(serving.wait(), 30)
        await services[Accounts].add_user("ann", Role.OPERATOR, PASSWORD, **BY)
        url = f"http://127.0.0.1:{listening.getsockname()[1]}"
        async with httpx.AsyncClient(base_url=url, headers=MADE_UP, trust_env=False, timeout=60) as client:
            response = await client.post("/login", data={"name": "ann", "password": PASSWORD})
        [event], _ = await services[EventLog].page(Filter(kind="login"), 10)
        server.end()
        await task
    assert (response.status_code, event["origin"]) == (303, origin)
    assert ("Secure" in response.headers["set-cookie"]) is is_https
