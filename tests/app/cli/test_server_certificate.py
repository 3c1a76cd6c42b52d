"""The certificate of the server: read at the start, replaced while connections are open, or kept."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from app.core.server import tls as server_certificate
from app.core.server.settings import TlsSettings
from app.core.server.tls import ServerCertificate
from bus.instants import unix_now
from bus.messages import Message
from bus.tls import TlsFileError, read_certificate
from tests.app.tls_site import GET, tls_site
from tests.certificates import certificates, renew

SOCKETS = 200


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


async def test_200_open_sockets_stay_while_the_certificate_changes(tmp_path: Path) -> None:
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
