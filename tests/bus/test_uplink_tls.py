"""A worker's link by TLS: it verifies the dashboard and its name, and names the end that has a fault. What
the dashboard holds against a worker's certificate: `tests.app.core.test_worker_certificate`."""

from __future__ import annotations

import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from websockets.asyncio.client import connect
from websockets.asyncio.server import serve
from websockets.exceptions import WebSocketException

from bus.tls import HTTP_ALPN, TlsFileError
from bus.worker.uplink import UplinkTls
from tests.certificates import certificates, renew


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


async def test_without_a_named_authority_those_of_the_machine_count(folder: Path) -> None:
    async with serving(server_context(folder)) as port:
        assert "unknown authority" in await fault_of(UplinkTls(), port)


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


def test_an_unknown_fault_of_verification_is_shown_as_openssl_has_it() -> None:
    error = ssl.SSLCertVerificationError()
    error.verify_code, error.verify_message = 77, "some reason"
    assert UplinkTls().fault(error).endswith("cannot be verified: some reason")


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
