"""What the dashboard holds against the certificate of a worker, as the worker's log has it; browsers are not
requested to show one."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import uvloop
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from bus.worker.uplink import UplinkTls
from tests.app.tls_site import GET, TlsSite, tls_site
from tests.for_each import for_each


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[TlsSite]:
    async with tls_site(tmp_path, client_ca=True) as site:
        yield site


def with_certificate(site: TlsSite, name: str) -> UplinkTls:
    pair = (site.folder / f"{name}.pem", site.folder / f"{name}.key")
    return UplinkTls(site.folder / "ca.pem", pair if name else None)


async def fault_of(port: int, tls: UplinkTls) -> str:
    """Of a worker; empty where its WebSocket was opened."""
    options = {"ssl": tls.context(), "create_connection": tls.connection, "proxy": None}
    try:
        async with connect(f"wss://localhost:{port}/feed", **options) as socket:
            await socket.send("hello")
            await socket.recv()
    except (OSError, WebSocketException) as error:
        return tls.fault(error) or f"no fault of TLS: {error}"
    return ""


FAULTS = [
    ("worker-expired", "it has expired"),
    ("other/worker", "client_ca of the dashboard has not signed it"),
    ("server", "unsupported certificate"),
]


@for_each(("name", "words"), FAULTS)
async def test_a_certificate_that_is_refused(site: TlsSite, name: str, words: str) -> None:
    fault = await fault_of(site.port, with_certificate(site, name))
    assert fault.startswith("the dashboard refused the certificate of this worker")
    assert words in fault
    assert site.scopes == []


def test_on_the_workers_own_event_loop(tmp_path: Path) -> None:
    async def faults() -> list[str]:
        async with tls_site(tmp_path, client_ca=True) as site:
            return [await fault_of(site.port, with_certificate(site, name)) for name, _ in FAULTS]

    for fault, (_, words) in zip(uvloop.run(faults()), FAULTS, strict=True):
        assert words in fault


@pytest.mark.parametrize(("name", "is_certified"), [("worker", True), ("", False)])
async def test_the_app_knows_whether_a_worker_has_shown_one(
    site: TlsSite, name: str, is_certified: bool
) -> None:
    assert await fault_of(site.port, with_certificate(site, name)) == ""
    assert [scope["certified"] for scope in site.scopes] == [is_certified]


async def test_a_browser_is_requested_to_show_none(site: TlsSite) -> None:
    """With one that would be refused it is served: it was not sent."""
    context = site.client()
    context.load_cert_chain(site.folder / "other" / "worker.pem", site.folder / "other" / "worker.key")
    reader, writer = await site.connect(context)
    writer.write(GET)
    assert await asyncio.wait_for(reader.readuntil(b"hello"), 30)
    assert [scope["certified"] for scope in site.scopes] == [False]
