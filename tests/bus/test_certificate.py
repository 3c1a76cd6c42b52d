"""The dates of certificates, as openssl reads them; what is cut off or malformed is refused."""

from __future__ import annotations

import base64
import random
from datetime import UTC, datetime
from pathlib import Path

import pytest

from bus.certificate import Certificate, MalformedCertificateError, certificates_in
from tests.certificates import certificates, subject_of

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


def test_a_year_of_two_digits_is_before_2050() -> None:
    text = made(der(0x17, b"491231000000Z"), der(0x17, b"690101000000Z"))
    (found,) = certificates_in(text)
    assert (found.begins_at, found.ends_at) == (day(2049, 12, 31), day(1969, 1, 1))


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


def test_damaged_bytes_raise_nothing_else(tmp_path: Path) -> None:
    (sound,) = certificates_in((certificates(tmp_path) / "server.pem").read_text())
    chance = random.Random(1)
    for _ in range(3000):
        damaged = bytearray(sound.der)
        for _ in range(chance.randint(1, 4)):
            damaged[chance.randrange(60 if chance.random() < 0.5 else len(damaged))] = chance.randrange(256)
        try:
            certificates_in(pem(bytes(damaged)))
        except MalformedCertificateError:
            continue
