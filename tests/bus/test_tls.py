"""The files of TLS, each fault named with its file, and the dates of certificates as openssl reads them."""

from __future__ import annotations

import base64
import ssl
import subprocess
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from bus.tls import (
    Certificate,
    MalformedCertificateError,
    TlsFileError,
    certificates_in,
    date_fault,
    load_authority,
    load_pair,
    read_certificate,
    stamp_of,
)
from tests.certificates import certificates, subject_of


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return certificates(tmp_path)


def context() -> ssl.SSLContext:
    return ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)


def test_a_pair_is_loaded(folder: Path) -> None:
    found = load_pair(context(), folder / "server.pem", folder / "server.key")
    assert found == read_certificate(folder / "server.pem")


def halve(file: Path) -> None:
    file.write_text(file.read_text()[:-60])


def swap_key(key: Path) -> None:
    key.write_bytes(key.with_name("worker.key").read_bytes())


def garble(key: Path) -> None:
    lines = key.read_text().splitlines()
    key.write_text("\n".join([lines[0], "AAAA" + lines[1][4:], *lines[2:]]))


@pytest.mark.parametrize(
    ("name", "spoil", "code"),
    [
        ("server.pem", Path.unlink, "tls_unreadable"),
        ("server.pem", halve, "tls_no_certificate"),
        ("server.key", Path.unlink, "tls_unreadable"),
        ("server.key", halve, "tls_no_key"),
        ("server.key", swap_key, "tls_key_differs"),
        ("server.key", garble, "tls_not_usable"),
    ],
)
def test_a_file_that_cannot_be_used_is_named(
    folder: Path, name: str, spoil: Callable[[Path], None], code: str
) -> None:
    spoil(folder / name)
    with pytest.raises(TlsFileError) as refused:
        load_pair(context(), folder / "server.pem", folder / "server.key")
    assert refused.value.message.code == code
    assert str(folder / name) in str(refused.value)


def test_a_key_with_a_passphrase_is_refused_at_once(folder: Path) -> None:
    key = folder / "server.key"
    plain = key.rename(key.with_name("plain.key"))
    words = ["openssl", "pkcs8", "-topk8", "-in", str(plain), "-out", str(key), "-passout", "pass:secret"]
    subprocess.run(words, check=True, capture_output=True)
    with pytest.raises(TlsFileError) as refused:
        load_pair(context(), folder / "server.pem", key)
    assert refused.value.message.code == "tls_key_encrypted"


def test_a_certificate_of_well_formed_dates_that_is_none(folder: Path) -> None:
    """The dates can be read, and openssl still refuses it."""
    times = (der(0x17, b"200101000000Z"), der(0x17, b"490101000000Z"))
    (folder / "ca.pem").write_text(made(*times))
    assert read_certificate(folder / "ca.pem").begins_at == day(2020, 1, 1)
    with pytest.raises(TlsFileError):
        load_authority(context(), folder / "ca.pem")


def test_the_dates(folder: Path) -> None:
    file = folder / "server.pem"
    found = read_certificate(file)
    faults = [date_fault(found, file, at) for at in (found.begins_at - 1, found.begins_at, found.ends_at)]
    assert [fault and fault.code for fault in faults] == ["tls_not_yet_valid", None, "tls_expired"]


def test_the_stamp_of_a_file_changes_with_it(folder: Path) -> None:
    file, before = folder / "server.pem", stamp_of(folder / "server.pem")
    assert before == stamp_of(file)
    file.write_text(file.read_text() + "\n")
    assert stamp_of(file) not in (before, None)
    file.unlink()
    assert stamp_of(file) is None


VERSION = bytes.fromhex("a003020102")


def der(tag: int, content: bytes) -> bytes:
    size = len(content)
    length = bytes([size]) if size < 128 else bytes([0x82]) + size.to_bytes(2, "big")
    return bytes([tag]) + length + content


def pem(der_bytes: bytes) -> str:
    body = base64.encodebytes(der_bytes).decode()
    return f"-----BEGIN CERTIFICATE-----\n{body}-----END CERTIFICATE-----\n"


def made(begins: bytes, ends: bytes, version: bytes = VERSION) -> str:
    """A certificate with these two times, each with its tag."""
    fields = der(2, b"\x01") + der(0x30, b"") + der(0x30, b"x" * 200) + der(0x30, begins + ends)
    return pem(der(0x30, der(0x30, version + fields + der(0x30, b"")) + der(0x30, b"") + der(3, b"\0")))


def day(year: int, month: int, day_of_month: int) -> float:
    return datetime(year, month, day_of_month, tzinfo=UTC).timestamp()


def test_the_dates_are_those_that_openssl_reads(tmp_path: Path) -> None:
    file = certificates(tmp_path) / "server.pem"
    (found,) = certificates_in(file.read_text())
    shown = datetime.fromtimestamp(found.ends_at, UTC).strftime("%b %e %H:%M:%S %Y GMT")
    assert f"Not After : {shown}" in subject_of(file)
    assert found.ends_on == datetime.fromtimestamp(found.ends_at, UTC).date().isoformat()


@pytest.mark.parametrize("version", [VERSION, b""])
def test_both_forms_of_a_time_and_a_certificate_without_version(version: bytes) -> None:
    text = made(der(0x17, b"510101000000Z"), der(0x18, b"20500101000000Z"), version)
    (found,) = certificates_in(f"a remark\n{text}")
    assert (found.begins_at, found.ends_at) == (day(1951, 1, 1), day(2050, 1, 1))
    assert isinstance(found, Certificate)


def test_several_come_in_their_order(tmp_path: Path) -> None:
    folder = certificates(tmp_path)
    chain = [(folder / name).read_text() for name in ("server.pem", "ca.pem")]
    assert certificates_in("".join(chain)) == [certificates_in(each)[0] for each in chain]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "-----BEGIN CERTIFICATE-----\nMIIB",
        "-----BEGIN CERTIFICATE-----\n-----END CERTIFICATE-----\n",
        "-----BEGIN CERTIFICATE-----\n%%%%\n-----END CERTIFICATE-----\n",
        pem(b"\x30\x03\x02"),
        pem(b"\x30"),
        pem(der(0x30, b"")),
        pem(der(0x30, der(0x30, b""))),
        made(b"", b""),
        made(der(0x16, b"490101000000Z"), der(0x17, b"500101000000Z")),
        made(der(0x17, b"499901000000Z"), der(0x17, b"500101000000Z")),
        made(der(0x17, b"\xff"), der(0x17, b"500101000000Z")),
    ],
)
def test_no_certificate_is_refused(text: str) -> None:
    with pytest.raises(MalformedCertificateError):
        certificates_in(text)


def test_any_part_of_a_file_is_a_certificate_or_refused(tmp_path: Path) -> None:
    text = (certificates(tmp_path) / "server.pem").read_text()
    for size in range(len(text) - 1):
        with pytest.raises(MalformedCertificateError):
            certificates_in(text[:size])
