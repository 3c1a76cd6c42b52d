"""Connections between servers: whose certificate is believed."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest

from app.routing.peers import Peers
from tests.certificates import certificates

OK = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\nConnection: close\r\n\r\nok"


@asynccontextmanager
async def served(folder: Path, name: str) -> AsyncIterator[str]:
    """A home with this certificate; its URL."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")

    async def respond(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(OK)
        writer.close()

    server = await asyncio.start_server(respond, "127.0.0.1", 0, ssl=context)
    async with server:
        yield f"https://localhost:{server.sockets[0].getsockname()[1]}/"


@pytest.mark.parametrize(
    ("certificate", "authority", "is_believed"),
    [
        ("server", "ca.pem", True),
        ("server", "other/ca.pem", False),
        ("server", "", False),
        ("misnamed", "ca.pem", False),
        ("expired", "ca.pem", False),
        ("other/server", "ca.pem", False),
    ],
)
async def test_only_a_server_that_the_authority_of_the_site_has_signed_is_a_home(
    tmp_path: Path, certificate: str, authority: str, is_believed: bool
) -> None:
    folder = certificates(tmp_path)
    peers = Peers(folder / authority if authority else None)
    async with served(folder, certificate) as url:
        if is_believed:
            assert (await peers.reading.get(url)).text == "ok"
        else:
            with pytest.raises(httpx.ConnectError):
                await peers.writing.get(url)
    await peers.close()


async def test_the_environment_leads_no_request_out_of_the_plant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HTTPS_PROXY", "http://127.0.0.1:1")
    folder = certificates(tmp_path)
    peers = Peers(folder / "ca.pem")
    async with served(folder, "server") as url:
        assert (await peers.reading.get(url)).status_code == 200
    await peers.close()
