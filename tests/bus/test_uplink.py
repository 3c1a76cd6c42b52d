"""The link to the app: the order of its messages, its timeouts, its log, its TLS and its addresses."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections.abc import AsyncIterator, MutableMapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs
from websockets.asyncio.client import connect
from websockets.asyncio.server import serve
from websockets.datastructures import Headers
from websockets.exceptions import WebSocketException
from websockets.http11 import Response

from bus.contract import (
    CONTRACT_VERSION,
    BusLink,
    Cancel,
    ClockSync,
    Command,
    Hello,
    Reading,
    SetSpeed,
    Snapshot,
    WantSnapshot,
    Watch,
)
from bus.contract.session import ClockOffset
from bus.tls import HTTP_ALPN, TlsFileError
from bus.worker.outbox import Outbox
from bus.worker.uplink import GOING_AWAY, AppAddresses, Uplink, UplinkTls, _about_status, feed_url
from tests.bus.fake_app import TOKEN, FakeApp
from tests.certificates import certificates, renew


class FakeReceiver:
    """Records the app's requests."""

    def __init__(self) -> None:
        self.requests: list[object] = []
        self.held: Sequence[int] = ()
        self.news = asyncio.Event()

    def hello(self) -> Hello:
        return Hello(CONTRACT_VERSION, "b", "worker-1", 0.0, "test", "/dev/none", time.time())

    def note_held(self, units: Sequence[int]) -> None:
        self.held = units

    def snapshot(self, seq: int) -> Snapshot:
        return Snapshot(seq, time.time(), BusLink(0.0, "closed"), [])

    def command(self, command: Command) -> None:
        self._keep(command)

    def reserve(self) -> None:
        self._keep("reserve")

    def cancel(self, command_id: str) -> None:
        self._keep(command_id)

    def watch(self, watch: Watch) -> None:
        self._keep(watch)

    def _keep(self, what: object) -> None:
        self.requests.append(what)
        self.news.set()

    async def until(self, what: object) -> None:
        async with asyncio.timeout(60):
            while what not in self.requests:
                self.news.clear()
                await self.news.wait()


@asynccontextmanager
async def linked(app: FakeApp, token: str = TOKEN) -> AsyncIterator[tuple[Outbox, FakeReceiver]]:
    outbox, receiver = Outbox(), FakeReceiver()
    uplink = Uplink([app.url], token, outbox, receiver, ClockOffset(), time.time)
    running = asyncio.create_task(uplink.run())
    try:
        yield outbox, receiver
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


@pytest.mark.parametrize(
    ("given", "feed"),
    [
        ("http://127.0.0.1:8000", "ws://127.0.0.1:8000/feed"),
        ("http://127.0.0.1:8000/", "ws://127.0.0.1:8000/feed"),
        ("https://mill.example", "wss://mill.example/feed"),
        ("ws://10.0.0.1:80/feed", "ws://10.0.0.1:80/feed"),
        ("https://mill.example/line", "wss://mill.example/line/feed"),
    ],
)
def test_the_address_of_the_feed(given: str, feed: str) -> None:
    assert feed_url(given) == feed


async def test_hello_snapshot_then_batches_that_are_forgotten_once_delivered() -> None:
    async with FakeApp() as app, linked(app) as (outbox, _):
        await app.until(app.snapshots)
        outbox.put([Reading(1, time.time(), 2, 3, 4, 5, 6)])
        await app.until(app.readings)
        assert [type(message).__name__ for message in app.messages] == ["Hello", "Snapshot", "Batch"]
        assert app.batches()[0].live
        for _ in range(1000):
            if not len(outbox):
                break
            await asyncio.sleep(0.01)
        assert len(outbox) == 0


async def test_the_apps_requests_reach_the_receiver() -> None:
    async with FakeApp() as app, linked(app) as (_, receiver):
        await app.until(app.snapshots)
        command = Command("c", time.time() + 2, SetSpeed(1, 5))
        for message in (Watch(units=[1]), ClockSync(app_time=time.time()), command, Cancel("c")):
            await app.send(message)
        await receiver.until("c")
        assert [each for each in receiver.requests if each != Watch(units=[])] == [
            Watch(units=[1]),
            command,
            "c",
        ]
        await app.send(WantSnapshot())
        await app.until(lambda: len(app.snapshots()) == 2)


async def test_it_reconnects_indefinitely_and_no_unit_is_watched_meanwhile() -> None:
    async with FakeApp() as app, linked(app) as (outbox, receiver):
        await app.until(app.snapshots)
        await app.send(Watch(units=[1]))
        await receiver.until(Watch(units=[1]))
        await app.stop()
        await receiver.until(Watch(units=[]))
        outbox.put([Reading(1, time.time(), 2, 3, 4, 5, 6)])
        await app.start()
        await app.until(app.readings)
        assert [batch.live for batch in app.batches()] == [False]


async def test_it_announces_that_it_leaves() -> None:
    async with FakeApp() as app:
        async with linked(app):
            await app.until(app.snapshots)
        await app.until(lambda: app.close_codes)
        assert app.close_codes == [GOING_AWAY]


async def test_a_wrong_token_is_named() -> None:
    with capture_logs() as logs:
        async with FakeApp() as app, linked(app, token="wrong"):
            await _logged(logs)
    assert "does not accept the token (401): create one with 'lineside token create'" in logs[0]["why"]
    assert logs[0]["why"].startswith(feed_url(app.url))


@pytest.mark.parametrize(
    ("body", "logged"),
    [
        (b'{"detail":"the token plc expired on 2026-11-22"}', "the token plc expired on 2026-11-22"),
        (b'{"detail":"two\\nlines\\u001b[31m"}', "twolines[31m"),
        (b'{"detail":"' + b"x" * 3000 + b'"}', "x" * 300),
        (b"<html>", "create one with 'lineside token create'"),
        (b'{"detail":7}', "create one with 'lineside token create'"),
        (b"\xff", "create one with 'lineside token create'"),
    ],
)
def test_why_a_token_is_not_accepted_is_one_line_of_bounded_length(body: bytes, logged: str) -> None:
    response = Response(403, "Forbidden", Headers(), body)
    assert _about_status(response) == f"the dashboard does not accept the token (403): {logged}"


async def test_a_refusal_and_another_version_are_named() -> None:
    for refuses, version, words in (("no [[bus]] is called b", 1, "no [[bus]]"), ("", 99, "version 99")):
        with capture_logs() as logs:
            async with FakeApp() as app:
                app.refuses, app.version = refuses, version
                async with linked(app):
                    await _logged(logs)
        assert words in logs[0]["why"]


async def _logged(logs: list[MutableMapping[str, Any]]) -> None:
    for _ in range(1000):
        if logs:
            return
        await asyncio.sleep(0.02)
    raise AssertionError("nothing was logged")


async def test_an_address_without_a_host_is_logged_and_does_not_end_the_worker() -> None:
    receiver = FakeReceiver()
    uplink = Uplink(["http://a..b:8000"], TOKEN, Outbox(), receiver, ClockOffset(), time.time)
    with capture_logs() as logs:
        linking = asyncio.create_task(uplink.run())
        async with asyncio.timeout(60):
            await receiver.news.wait()
        assert not linking.done()
        linking.cancel()
    assert "no dashboard at ws://a..b:8000/feed" in logs[0]["why"]


async def test_a_worker_goes_on_to_the_app_that_takes_it() -> None:
    async with FakeApp() as a, FakeApp() as b:
        a.refuses = "not here"
        outbox, receiver = Outbox(), FakeReceiver()
        uplink = Uplink(
            [a.url, "http://127.0.0.1:9", b.url], TOKEN, outbox, receiver, ClockOffset(), time.time
        )
        running = asyncio.create_task(uplink.run())
        await b.until(b.snapshots)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return certificates(tmp_path)


def server_context(folder: Path, name: str = "server") -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")
    context.set_alpn_protocols([HTTP_ALPN])
    return context


@asynccontextmanager
async def serving(context: ssl.SSLContext) -> AsyncIterator[int]:
    """A server that opens every WebSocket; by TLS as the dashboard has it."""
    async with serve(lambda socket: socket.wait_closed(), "127.0.0.1", 0, ssl=context) as server:
        yield next(iter(server.sockets)).getsockname()[1]


async def fault_of(tls: UplinkTls, port: int) -> str:
    """Of a connection; empty where it was opened."""
    options = {"ssl": tls.context(), "create_connection": tls.connection, "proxy": None}
    try:
        async with connect(f"wss://localhost:{port}/feed", **options) as socket:
            await socket.ping()
    except (OSError, WebSocketException) as error:
        return tls.fault(error) or f"no fault of TLS: {error}"
    return ""


def with_certificate(folder: Path, name: str = "worker") -> UplinkTls:
    return UplinkTls(folder / "ca.pem", (folder / f"{name}.pem", folder / f"{name}.key"))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("server", ""),
        ("expired", "the dashboard's certificate has expired"),
        ("misnamed", "the dashboard's certificate is not for this name"),
        ("other/server", "the dashboard's certificate is of an unknown authority"),
    ],
)
async def test_the_certificate_of_the_dashboard(folder: Path, name: str, words: str) -> None:
    async with serving(server_context(folder, name)) as port:
        fault = await fault_of(UplinkTls(folder / "ca.pem"), port)
    assert fault.startswith(words)
    assert bool(fault) == bool(words)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ValueError("no"), ""),
        (ssl.SSLError(1, "[SSL: UNEXPECTED_MESSAGE] unexpected"), "TLS failed"),
    ],
)
def test_other_faults(error: Exception, words: str) -> None:
    assert UplinkTls().fault(error).startswith(words)
    assert bool(UplinkTls().fault(error)) == bool(words)


def test_the_files_are_read_again_once_they_have_changed(folder: Path) -> None:
    tls = with_certificate(folder)
    first = tls.context()
    assert tls.context() is first
    renew(folder, "worker")
    second = tls.context()
    assert second is not first
    key = folder / "worker.key"
    text = key.read_text()
    key.write_text(text[:50])
    with pytest.raises(TlsFileError):
        tls.context()
    key.write_text(text)
    assert tls.context() is not second


def test_the_name_is_always_verified(folder: Path) -> None:
    for tls in (UplinkTls(), UplinkTls(folder / "ca.pem"), with_certificate(folder)):
        assert tls.context().check_hostname
        assert tls.context().verify_mode is ssl.CERT_REQUIRED
        assert tls.context().minimum_version is ssl.TLSVersion.TLSv1_2


A, B = "http://a:8000", "https://b:8000/"


def test_it_goes_to_each_address_in_turn() -> None:
    addresses = AppAddresses([A, B])
    seen = []
    for _ in range(3):
        seen.append(addresses.feed)
        addresses.leave()
    assert seen == ["ws://a:8000/feed", "wss://b:8000/feed", "ws://a:8000/feed"]
