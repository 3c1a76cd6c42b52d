"""The files of TLS: each fault is named with its file."""

from __future__ import annotations

import ssl
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from bus.tls import TlsFileError, date_fault, load_authority, load_pair, read_certificate, stamp_of
from tests.bus.test_certificate import day, der, made
from tests.certificates import certificates


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


def test_an_authority(folder: Path) -> None:
    trusting = context()
    load_authority(trusting, folder / "ca.pem")
    assert len(trusting.get_ca_certs()) == 1
    halve(folder / "ca.pem")
    with pytest.raises(TlsFileError):
        load_authority(context(), folder / "ca.pem")


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
