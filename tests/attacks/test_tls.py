"""Attacks on the port of HTTPS: handshakes without an end, garbage and renegotiation cost their sender alone,
and others are served meanwhile."""

from __future__ import annotations

import asyncio
import ssl
import subprocess
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, suppress

import httpx
import pytest

from app.core.server.connections import MAX_OF_ADDRESS
from tests.app.served_tls import PATIENCE_S, Served, served

BRIEF_S = 0.5
Ends = tuple[asyncio.StreamReader, asyncio.StreamWriter]
Attack = Callable[[Served], Awaitable[None]]


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("attacked")) as target:
        yield target


def client_hello(target: Served) -> bytes:
    outgoing = ssl.MemoryBIO()
    tls = target.context.wrap_bio(ssl.MemoryBIO(), outgoing, server_hostname="localhost")
    with suppress(ssl.SSLWantReadError):
        tls.do_handshake()
    return outgoing.read()


@asynccontextmanager
async def many(target: Served, count: int, begun: bytes = b"") -> AsyncIterator[list[Ends]]:
    """Connections that have sent ``begun``."""
    opened: list[Ends] = []
    try:
        for _ in range(count):
            opened.append(await asyncio.open_connection("127.0.0.1", target.port))
            opened[-1][1].write(begun)
        yield opened
    finally:
        for _, writer in opened:
            writer.transport.abort()
            with suppress(OSError):
                await writer.wait_closed()


async def unfinished_handshakes(target: Served) -> None:
    async with many(target, MAX_OF_ADDRESS + 100, client_hello(target)):
        await asyncio.sleep(BRIEF_S)


async def connections_without_a_handshake(target: Served) -> None:
    async with many(target, MAX_OF_ADDRESS + 100):
        await asyncio.sleep(BRIEF_S)


async def handshakes_begun_and_dropped(target: Served) -> None:
    hello = client_hello(target)
    for _ in range(4):
        async with many(target, 100, hello):
            await asyncio.sleep(0)


async def halves_of_a_record(target: Served) -> None:
    async with many(target, 200, client_hello(target)[:200]):
        await asyncio.sleep(BRIEF_S)


async def garbage_records(target: Served) -> None:
    for garbage in (
        b"\x16\x03\x01\x00\x20" + b"x" * 32,
        b"\x16\x03\x01\xff\xff",
        b"\x15\x03\x03\x00\x02\x02\x50",
    ):
        async with many(target, 50, garbage * 100):
            await asyncio.sleep(BRIEF_S / 5)


async def plain_requests(target: Served) -> None:
    async with many(target, 100, b"GET / HTTP/1.1\r\nHost: here\r\n\r\n" * 50) as opened:
        first = await asyncio.wait_for(opened[-1][0].read(), PATIENCE_S)
    assert b"begin the address with https://" in first


async def records_of_a_byte(target: Served) -> None:
    """8 senders whose 2,000 bytes are one header, each byte a record."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    for _ in range(8):
        tls = target.context.wrap_bio(incoming, outgoing, server_hostname="localhost")
        reader, writer = await asyncio.open_connection("127.0.0.1", target.port)
        while True:
            try:
                tls.do_handshake()
                break
            except ssl.SSLWantReadError:
                writer.write(outgoing.read())
                incoming.write(await asyncio.wait_for(reader.read(65536), PATIENCE_S))
        for byte in b"GET / HTTP/1.1\r\nX: " + b"x" * 2000:
            tls.write(bytes([byte]))
        writer.write(outgoing.read())
        await writer.drain()
        writer.transport.abort()
        incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()


ATTACKS: list[Attack] = [
    unfinished_handshakes,
    connections_without_a_handshake,
    handshakes_begun_and_dropped,
    halves_of_a_record,
    garbage_records,
    plain_requests,
    records_of_a_byte,
]


async def the_line(client: httpx.AsyncClient) -> httpx.Response:
    """Request the line, by a new connection where this busy machine left the open one idle for too long."""
    try:
        return await client.get("/api/v1/line")
    except httpx.RemoteProtocolError:
        return await client.get("/api/v1/line")


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
async def test_others_are_served_meanwhile_and_afterwards(target: Served, attack: Attack) -> None:
    headers = {"Authorization": f"Bearer {target.tokens['viewer']}"}
    async with httpx.AsyncClient(
        base_url=target.url, verify=target.context, headers=headers, trust_env=False, timeout=PATIENCE_S
    ) as client:
        attacking = asyncio.create_task(attack(target))
        served_meanwhile = 0
        while not attacking.done():
            assert (await the_line(client)).status_code == 200
            served_meanwhile += 1
        await attacking
        assert served_meanwhile
        assert (await client.get("/api/v1/line")).status_code == 200
    async with httpx.AsyncClient(verify=target.context, trust_env=False, timeout=PATIENCE_S) as stranger:
        assert (await stranger.get(f"{target.url}/healthz")).status_code == 200


def openssl(target: Served, *options: str, keys: str) -> str:
    """What ``openssl s_client`` reports of these keys, one each on a line."""
    words = ["openssl", "s_client", "-connect", f"localhost:{target.port}", *options]
    done = subprocess.run(words, input=keys.encode(), capture_output=True, timeout=PATIENCE_S)
    return (done.stdout + done.stderr).decode("utf-8", "replace")


def test_renegotiation_is_refused(target: Served) -> None:
    report = openssl(target, "-tls1_2", keys="R\n")
    assert "RENEGOTIATING" in report
    assert "no renegotiation" in report


def test_many_updates_of_the_keys_end_their_connection_alone(target: Served) -> None:
    assert "KEYUPDATE" in openssl(target, "-tls1_3", keys="K\n" * 100)
    with target.client() as client:
        assert client.get("/healthz").status_code == 200
