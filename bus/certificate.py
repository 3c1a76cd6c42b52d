"""When certificates begin and end, from their files (RFC 7468, RFC 5280). Pure; the library that speaks TLS
reads them, but does not give the dates of a certificate that it does not trust."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

from bus.instants import UnixTime

_PEM = re.compile(r"-----BEGIN CERTIFICATE-----\s(.*?)-----END CERTIFICATE-----", re.DOTALL)
_VERSION, _UTC_TIME, _GENERALIZED_TIME = 0xA0, 0x17, 0x18
"""Tags of DER: the version of a certificate, which may be left out, and the two forms of a time."""
_FORMATS = {_UTC_TIME: "%y%m%d%H%M%SZ", _GENERALIZED_TIME: "%Y%m%d%H%M%SZ"}
_VALIDITY = 3
"""Its place in a certificate, after serial number, algorithm and issuer."""
_FIRST_CENTURY_UNTIL = 2050
"""A year of two digits is before it (RFC 5280, 4.1.2.5.1)."""


class MalformedCertificateError(ValueError):
    """A file holds no certificate, or one that is cut off or malformed."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """One certificate. ``der``: its bytes."""

    der: bytes
    begins_at: UnixTime
    ends_at: UnixTime

    @property
    def ends_on(self) -> str:
        """The day on which it ends, in UTC, as ISO 8601 writes it."""
        return datetime.fromtimestamp(float(self.ends_at), UTC).date().isoformat()


def certificates_in(pem: str) -> list[Certificate]:
    """The certificates of a file, in its order; of a server's, its own comes first. Raises
    MalformedCertificateError where one is cut off or malformed, or there is none."""
    bodies = _PEM.findall(pem)
    if not bodies or len(bodies) != pem.count("-----BEGIN CERTIFICATE-----"):
        raise MalformedCertificateError("no certificate, or a part of one")
    return [_certificate(body) for body in bodies]


def _certificate(body: str) -> Certificate:
    try:
        der = base64.b64decode("".join(body.split()), validate=True)
        ((_, signed),) = _elements(der)
        _, content = next(_elements(signed))
        fields = [field for field in _elements(content) if field[0] != _VERSION]
        begins, ends = (_time(*field) for field in _elements(fields[_VALIDITY][1]))
    except (ValueError, IndexError, KeyError, StopIteration) as error:
        raise MalformedCertificateError("a malformed certificate") from error
    return Certificate(der, begins, ends)


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Tag and content of each element of a DER sequence. Raises IndexError where it is cut off."""
    at = 0
    while at < len(data):
        tag, length = data[at], data[at + 1]
        at += 2
        if length & 0x80:
            size = length & 0x7F
            length = int.from_bytes(data[at : at + size], "big")
            at += size
        if at + length > len(data):
            raise IndexError("cut off")
        yield tag, data[at : at + length]
        at += length


def _time(tag: int, text: bytes) -> UnixTime:
    at = datetime.strptime(text.decode("ascii"), _FORMATS[tag]).replace(tzinfo=UTC)
    if tag == _UTC_TIME and at.year >= _FIRST_CENTURY_UNTIL:
        at = at.replace(year=at.year - 100)
    return UnixTime(at.timestamp())
