"""TLS at the gate: handshakes, records, arrival times, and a certificate that is replaced while it is
served."""

from __future__ import annotations

import asyncio
import gc
import math
import ssl
import weakref
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest
from websockets.asyncio.client import connect

from app.core.server import tls as server_certificate
from app.core.server.connections import MAX_OF_ADDRESS, WITHIN_S, Awaited
from app.core.server.settings import TlsSettings
from app.core.server.tls import HEADER_BYTES, ServerCertificate
from bus.instants import monotonic_now, unix_now
from bus.messages import Message
from bus.tls import TlsFileError, read_certificate
from tests.app.gated import PATIENCE_S, Ends, everything, until
from tests.app.tls_site import GET, TlsSite, tls_site
from tests.certificates import certificates, renew
from tests.for_each import for_each


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[TlsSite]:
    async with tls_site(tmp_path) as site:
        yield site


async def response(ends: Ends, request: bytes = GET, ending: bytes = b"hello") -> bytes:
    reader, writer = ends
    writer.write(request)
    return await asyncio.wait_for(reader.readuntil(ending), PATIENCE_S)


class ByHand:
    """A client whose records the test sends."""

    def __init__(self, site: TlsSite, ends: Ends) -> None:
        self.reader, self.writer = ends
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self.tls = site.client().wrap_bio(self._incoming, self._outgoing, server_hostname="localhost")

    def hello(self) -> bytes:
        with pytest.raises(ssl.SSLWantReadError):
            self.tls.do_handshake()
        return self._outgoing.read()

    async def finish(self) -> bytes:
        """Read the server's part; return the client's last."""
        while True:
            self._incoming.write(await asyncio.wait_for(self.reader.read(65536), PATIENCE_S))
            try:
                self.tls.do_handshake()
            except ssl.SSLWantReadError:
                continue
            return self._outgoing.read()

    def records(self, *parts: bytes) -> bytes:
        for part in parts:
            self.tls.write(part)
        return self._outgoing.read()

    async def text(self, ending: bytes) -> bytes:
        found = b""
        while not found.endswith(ending):
            try:
                found += self.tls.read(65536)
            except ssl.SSLWantReadError:
                self._incoming.write(await asyncio.wait_for(self.reader.read(65536), PATIENCE_S))
        return found


async def by_hand(site: TlsSite) -> ByHand:
    """A client after its handshake."""
    client = ByHand(site, await site.plain())
    client.writer.write(client.hello())
    client.writer.write(await client.finish())
    return client


async def test_a_request_is_of_https_and_its_client_is_known(site: TlsSite) -> None:
    ends = await site.connect()
    assert (await response(ends)).endswith(b"hello")
    assert (await response(ends)).endswith(b"hello")
    first, second = site.scopes
    assert (first["scheme"], first["client"][0], first["certified"]) == ("https", "127.0.0.1", False)
    assert first["client"] == second["client"]
    assert ends[1].get_extra_info("ssl_object").selected_alpn_protocol() == "http/1.1"


async def test_large_bodies_pass_both_ways(site: TlsSite) -> None:
    site.response = bytes(1_000_000) + b"end"
    body = b"x" * 300_000
    head = b"POST / HTTP/1.1\r\nHost: here\r\nContent-Length: %d\r\n\r\n" % len(body)
    got = await response(await site.connect(limit=2_000_000), head + body, b"end")
    assert got.endswith(site.response)
    assert site.bodies == [body]


async def test_a_websocket_by_tls(site: TlsSite) -> None:
    async with connect(f"wss://localhost:{site.port}/live", ssl=site.client(), proxy=None) as socket:
        for text in ("a", "b" * 7000):
            await socket.send(text)
            assert await socket.recv() == text
    assert site.scopes[0]["scheme"] == "wss"


@for_each("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
async def test_both_versions_are_spoken(site: TlsSite, version: ssl.TLSVersion) -> None:
    context = site.client()
    context.minimum_version = context.maximum_version = version
    assert await response(await site.connect(context))


@pytest.mark.filterwarnings("ignore:ssl.TLSVersion")
async def test_an_older_version_is_refused(site: TlsSite) -> None:
    context = site.client()
    context.set_ciphers("DEFAULT@SECLEVEL=0")
    context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
    with pytest.raises((ssl.SSLError, ConnectionError)):
        await site.connect(context)


async def test_every_byte_may_come_alone(site: TlsSite) -> None:
    client = ByHand(site, await site.plain())
    for byte in client.hello():
        client.writer.write(bytes([byte]))
        await asyncio.sleep(0)
    last = await client.finish()
    for byte in last + client.records(*(bytes([each]) for each in GET)):
        client.writer.write(bytes([byte]))
        await asyncio.sleep(0)
    assert (await client.text(b"hello")).startswith(b"HTTP/1.1 200")


async def test_a_request_has_the_time_at_which_its_first_record_arrived(site: TlsSite) -> None:
    client = await by_hand(site)
    await until(lambda: site.served.made[0].is_encrypted)
    received = site.served.received
    client.writer.write(client.records(GET[:1]))
    await until(lambda: site.served.received > received)
    begun = monotonic_now()
    await asyncio.sleep(0.3)
    client.writer.write(client.records(GET[1:]))
    await client.text(b"hello")
    client.writer.write(client.records(GET))
    await client.text(b"hello")
    first, second = site.arrivals
    assert first <= float(begun) < second


async def test_a_handshake_without_an_end_has_the_time_of_a_first_request(site: TlsSite) -> None:
    idle, begun = await site.plain(), ByHand(site, await site.plain())
    begun.writer.write(begun.hello())
    # The time in which a handshake waits for its turn is not the client's.
    assert await asyncio.wait_for(begun.reader.read(1), PATIENCE_S)
    site.served.pass_s_of_port(WITHIN_S[Awaited.FIRST] - 1)
    assert site.served.is_open(0)
    assert site.served.is_open(1)
    site.served.pass_s(WITHIN_S[Awaited.FIRST] + 1)
    assert await everything(idle[0]) == b""
    await until(lambda: not site.served.gates.open)


async def test_unfinished_handshakes_displace_one_another(
    site: TlsSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    for awaited in WITHIN_S:
        monkeypatch.setitem(WITHIN_S, awaited, math.inf)  # on a busy machine they would end meanwhile
    served, known = await site.connect(), GET.replace(b"/", b"/known", 1)
    assert await response(served, known)
    ends = [await site.plain() for _ in range(MAX_OF_ADDRESS + 5)]
    await until(lambda: len(site.served.gates.open) == MAX_OF_ADDRESS + 1)
    assert await response(served, known)
    for _, writer in ends:
        writer.close()


async def test_plain_http_gets_a_hint(site: TlsSite) -> None:
    reader, writer = await site.plain()
    writer.write(GET)
    got = await everything(reader)
    assert got.startswith(b"HTTP/1.1 400")
    assert b"begin the address with https://" in got
    assert site.scopes == []


@for_each(
    "garbage",
    [
        b"\x80\x2e\x01\x00\x02",
        b"\x00" * 40,
        b"\x16\x03\x01\xff\xff" + b"x" * 100,
        b"\x16\x03\x01\x00\x05abcde",
        b"\x16\x03\x01\x00\x00",
    ],
)
async def test_garbage_is_no_handshake(site: TlsSite, garbage: bytes) -> None:
    reader, writer = await site.plain()
    writer.write(garbage)
    if len(garbage) > HEADER_BYTES:
        got = await everything(reader)
        assert got == b"" or got[0] == 21  # an alert
    writer.close()
    assert await response(await site.connect())


async def test_garbage_after_the_handshake_ends_the_connection(site: TlsSite) -> None:
    client = await by_hand(site)
    client.writer.write(b"\x17\x03\x03\x00\x20" + b"x" * 32)
    await asyncio.wait_for(client.reader.read(), PATIENCE_S)
    await until(lambda: not site.served.gates.open)
    assert site.scopes == []


async def test_the_end_is_announced_and_the_socket_closes(site: TlsSite) -> None:
    reader, writer = await site.connect()
    writer.write(b"GET / HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n")
    assert (await everything(reader)).endswith(b"hello")
    await until(lambda: not site.served.gates.open)


async def test_the_clients_end_closes_the_connection(site: TlsSite) -> None:
    _, writer = await site.connect()
    writer.close()
    await until(lambda: not site.served.gates.open)


async def test_a_refusal_reaches_a_client_that_goes_on_sending(site: TlsSite) -> None:
    reader, writer = await site.connect()
    writer.write(b"GET / HTTP/1.1\r\nX: " + b"x" * 40_000)
    got = b""
    while b"\r\n\r\n" not in got:
        got += await asyncio.wait_for(reader.read(1000), PATIENCE_S)
    assert got.startswith(b"HTTP/1.1 431")
    writer.close()


async def test_a_connection_that_has_ended_is_freed_at_once(site: TlsSite) -> None:
    reader, writer = await site.connect()
    assert await response((reader, writer))
    gate = site.served.made.pop()
    left = [weakref.ref(gate), weakref.ref(gate.inner)]
    del gate
    site.scopes.clear()
    gc.disable()
    try:
        writer.close()
        await until(lambda: not any(each() for each in left))
    finally:
        gc.enable()


SOCKETS = 50


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return certificates(tmp_path)


def settings(folder: Path, name: str = "server", client_ca: str = "") -> TlsSettings:
    ca = folder / client_ca if client_ca else None
    return TlsSettings(certificate=folder / f"{name}.pem", key=folder / f"{name}.key", client_ca=ca)


class Reloads(list[tuple[str, str]]):
    """The codes of what was reported: what happened, and why not."""

    async def __call__(self, what: Message, fault: Message | None) -> None:
        self.append((what.code, fault.code if fault else ""))


async def looked(certificate: ServerCertificate, times: int = 3) -> Reloads:
    reloads = Reloads()
    for _ in range(times):
        await certificate.look(reloads)
    return reloads


async def test_nothing_is_reported_while_nothing_changes(folder: Path) -> None:
    assert await looked(ServerCertificate(settings(folder, client_ca="ca.pem"))) == []


async def test_a_new_certificate_is_taken_and_reported_once(folder: Path) -> None:
    certificate = ServerCertificate(settings(folder))
    before = certificate.context_for(b"")
    renew(folder)
    assert await looked(certificate) == [("event_certificate_reloaded", "")]
    assert certificate.context_for(b"") is not before
    assert certificate.fault is None


def copy_from(source: str) -> Callable[[Path], None]:
    def copy(folder: Path) -> None:
        for ending in ("pem", "key"):
            name = f"{source}.{ending}"
            (folder / f"server.{ending}").write_bytes((folder / name).read_bytes())

    return copy


def halve(folder: Path) -> None:
    file = folder / "server.pem"
    file.write_text(file.read_text()[:300])


def swap_key(folder: Path) -> None:
    (folder / "server.key").write_bytes((folder / "worker.key").read_bytes())


def remove(folder: Path) -> None:
    (folder / "server.pem").unlink()


def halve_authority(folder: Path) -> None:
    (folder / "ca.pem").write_text((folder / "ca.pem").read_text()[:300])


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (halve, "tls_no_certificate"),
        (swap_key, "tls_key_differs"),
        (remove, "tls_unreadable"),
        (halve_authority, "tls_no_certificate"),
        (copy_from("expired"), "tls_expired"),
    ],
)
async def test_the_former_one_stays_and_the_reason_is_known(
    folder: Path, change: Callable[[Path], None], code: str
) -> None:
    certificate = ServerCertificate(settings(folder, client_ca="ca.pem"))
    before = certificate.context_for(b"")
    kept = {file: file.read_bytes() for file in settings(folder, client_ca="ca.pem").files}
    change(folder)
    assert await looked(certificate) == [("event_certificate_refused", code)]
    assert certificate.context_for(b"") is before
    assert certificate.fault is not None
    assert certificate.fault.code == code
    for file, content in kept.items():
        file.write_bytes(content)
    assert await looked(certificate) == [("event_certificate_reloaded", "")]
    assert certificate.fault is None


async def test_files_that_are_being_written_are_left_alone(folder: Path) -> None:
    certificate, reloads = ServerCertificate(settings(folder)), Reloads()
    for size in range(100, 600, 100):
        (folder / "server.pem").write_text("x" * size)
        await certificate.look(reloads)
    renew_into(folder)
    await certificate.look(reloads)
    assert reloads == []
    await certificate.look(reloads)
    assert reloads == [("event_certificate_reloaded", "")]


def renew_into(folder: Path) -> None:
    """As by a program that writes the file itself."""
    (folder / "server.pem").unlink()
    renew(folder)


@pytest.mark.parametrize("name", ["server.pem", "server.key", "ca.pem"])
def test_a_missing_file_stops_the_start(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(TlsFileError):
        ServerCertificate(settings(folder, client_ca="ca.pem"))


def test_an_expired_one_serves_from_the_start_and_its_fault_is_known(folder: Path) -> None:
    fault = ServerCertificate(settings(folder, "expired")).fault
    assert fault is not None
    assert fault.code == "tls_expired"


def test_one_that_expires_while_it_serves_is_a_fault_from_then_on(folder: Path) -> None:
    ends = read_certificate(folder / "server.pem").ends_at
    now = unix_now()
    certificate = ServerCertificate(settings(folder), lambda: now)
    assert certificate.fault is None
    now = ends
    assert certificate.fault is not None
    assert certificate.fault.params["day"] == datetime.fromtimestamp(ends, UTC).date().isoformat()


async def test_it_looks_without_end(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_certificate, "LOOK_EVERY_S", 0.0)
    certificate, reloads = ServerCertificate(settings(folder)), Reloads()
    following = asyncio.create_task(certificate.follow(reloads))
    renew(folder)
    async with asyncio.timeout(30):
        while not reloads:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
    following.cancel()


async def test_open_sockets_stay_while_the_certificate_changes(tmp_path: Path) -> None:
    async with tls_site(tmp_path) as site:
        sockets = [await site.connect() for _ in range(SOCKETS)]
        before = shown_to(sockets[0])
        renew(tmp_path)
        assert await looked(site.certificate) == [("event_certificate_reloaded", "")]
        for reader, writer in sockets:
            writer.write(GET)
            assert await asyncio.wait_for(reader.readuntil(b"hello"), 30)
        assert shown_to(await site.connect()) != before


def shown_to(ends: tuple[asyncio.StreamReader, asyncio.StreamWriter]) -> bytes | None:
    tls: ssl.SSLObject = ends[1].get_extra_info("ssl_object")
    return tls.getpeercert(binary_form=True)
