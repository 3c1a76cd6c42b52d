"""The certificate of the OPC UA server, its trust list, and the tokens of programs."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from app.people.auth.rules import secret_hash
from app.system.opcua.access import (
    DAYS,
    MAX_REJECTED,
    AccessError,
    TokenList,
    TrustList,
    certificate_file,
    own_certificate,
    uri_of,
)
from app.system.opcua.link import Key
from bus.instants import UnixTime

NOW = datetime(2026, 11, 29, tzinfo=UTC)


def der(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(Encoding.DER)


def test_the_certificate_is_made_once_and_holds_its_uri_and_names(tmp_path: Path) -> None:
    own = own_certificate(tmp_path, ("opc.mill7", "10.0.0.5"), "Mill 7", NOW)
    names = own.certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert uri_of(own.certificate) == own.uri
    assert own.uri.startswith("urn:")
    assert "opc.mill7" in names.get_values_for_type(x509.DNSName)
    assert "10.0.0.5" in map(str, names.get_values_for_type(x509.IPAddress))
    assert (tmp_path / "own" / "key.pem").stat().st_mode & 0o077 == 0
    assert der(own_certificate(tmp_path, (), "Mill 7", NOW).certificate) == der(own.certificate)


def test_the_certificate_is_renewed_with_its_key_and_uri_before_it_ends(tmp_path: Path) -> None:
    own = own_certificate(tmp_path, (), "Mill 7", NOW)
    renewed = own_certificate(tmp_path, (), "Mill 7", NOW + timedelta(days=DAYS - 10))
    assert renewed.certificate.serial_number != own.certificate.serial_number
    assert renewed.uri == own.uri
    assert renewed.certificate.public_key() == own.certificate.public_key()


def test_files_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    own_certificate(tmp_path / "one", (), "Mill 7", NOW)
    own_certificate(tmp_path / "other", (), "Mill 7", NOW)
    certificate_file(tmp_path / "one").write_bytes(certificate_file(tmp_path / "other").read_bytes())
    with pytest.raises(AccessError) as refused:
        own_certificate(tmp_path / "one", (), "Mill 7", NOW)
    assert refused.value.message.code == "opcua_not_a_pair"
    certificate_file(tmp_path / "one").write_bytes(b"no certificate")
    with pytest.raises(AccessError) as refused:
        own_certificate(tmp_path / "one", (), "Mill 7", NOW)
    assert refused.value.message.code == "opcua_files"


def test_a_client_is_trusted_while_its_file_is_there(tmp_path: Path) -> None:
    own_certificate(tmp_path, (), "Mill 7", NOW)
    client = own_certificate(tmp_path / "client", (), "Historian", NOW).certificate
    trust = TrustList(tmp_path)
    trust.read()
    assert not trust.trusts(der(client))
    trust.reject(der(client))
    assert trust.waiting() == 1
    (rejected,) = (tmp_path / "rejected").iterdir()
    assert "Historian" in rejected.name
    trusted = rejected.rename(tmp_path / "trusted" / rejected.name)
    trust.read()
    assert trust.trusts(der(client))
    assert trust.waiting() == 0
    trusted.unlink()
    trust.read()
    assert not trust.trusts(der(client))


def test_a_certificate_is_trusted_as_pem_and_another_file_is_not_read(tmp_path: Path) -> None:
    own_certificate(tmp_path, (), "Mill 7", NOW)
    client = own_certificate(tmp_path / "client", (), "Historian", NOW).certificate
    trusted = tmp_path / "trusted"
    (trusted / "client.pem").write_bytes(client.public_bytes(Encoding.PEM))
    (trusted / "damaged.der").write_bytes(b"\x30\x82")
    (trusted / "readme.txt").write_text("nothing")
    trust = TrustList(tmp_path)
    trust.read()
    assert trust.trusts(der(client))


def test_of_many_rejected_certificates_the_newest_are_kept(tmp_path: Path) -> None:
    own = own_certificate(tmp_path, (), "Mill 7", NOW)
    trust, content = TrustList(tmp_path), der(own.certificate)
    for number in range(MAX_REJECTED + 5):
        (tmp_path / "rejected" / f"{number}.der").write_bytes(content)
    trust.reject(content)
    trust.reject(b"no certificate")
    trust.reject(b"x" * 100_000)
    assert trust.waiting() == MAX_REJECTED


def test_a_program_signs_in_by_the_name_and_the_secret_of_its_token() -> None:
    key = Key(1, "historian", secret_hash("secret"), UnixTime(2e12))
    tokens = TokenList()
    tokens.set([key, Key(2, "old", secret_hash("secret"), UnixTime(1.0))])
    assert tokens.find("historian", "secret") == key
    assert tokens.find("historian", "wrong") is None
    assert tokens.find("nobody", "secret") is None
    assert tokens.find("old", "secret") is None, "it has expired"
    tokens.set([Key(3, "historian", secret_hash("another"), None)])
    assert not tokens.holds(key), "it was revoked and created again"
