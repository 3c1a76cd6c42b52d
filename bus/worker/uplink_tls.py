"""TLS of the link to the app: the worker's files, and what went wrong with the handshake in words."""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection

from bus.tls import HTTP_ALPN, WORKER_ALPN, FileStamp, load_authority, load_pair, stamp_of

_OF_DASHBOARD = {
    9: "the dashboard's certificate is not valid yet: compare the clocks of both machines",
    10: "the dashboard's certificate has expired: renew it there with 'lineside certificate create'",
    62: "the dashboard's certificate is not for this name: use one of its names in --app, or create it "
    "again with --name",
    64: "the dashboard's certificate is not for this address: use one of its names in --app, or create it "
    "again with --name",
}
"""By error of OpenSSL's verification (X509_V_ERR_…)."""
_UNKNOWN_AUTHORITY = frozenset({2, 18, 19, 20, 21})
_ALERTS = {
    "CERTIFICATE_EXPIRED": "it has expired: renew it with 'lineside certificate create'",
    "UNKNOWN_CA": "the authority in client_ca of the dashboard has not signed it",
    "CERTIFICATE_REQUIRED": "none was shown: give --certificate and --key",
}
"""What the dashboard holds against the worker's certificate, by the end of an alert's name."""
_NO_TLS = frozenset({"WRONG_VERSION_NUMBER", "HTTP_REQUEST", "RECORD_LAYER_FAILURE"})


class _LinkConnection(ClientConnection):
    """Keeps why it was lost: the library reports an alert during its opening handshake as a mere end."""

    lost_by: Exception | None = None

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost_by = exc
        super().connection_lost(exc)


@dataclass(slots=True)
class UplinkTls:
    """``ca``: the authority of the dashboard; None: those that this machine trusts. ``pair``: the worker's
    certificate and its key, which are read again when they have changed."""

    ca: Path | None = None
    pair: tuple[Path, Path] | None = None
    _context: ssl.SSLContext | None = field(default=None, init=False)
    _stamps: tuple[FileStamp, ...] = field(default=(), init=False)
    _connection: _LinkConnection | None = field(default=None, init=False)

    def context(self) -> ssl.SSLContext:
        """Of the next connection, which verifies the dashboard and its name. Raises TlsFileError."""
        stamps = tuple(map(stamp_of, (*((self.ca,) if self.ca else ()), *(self.pair or ()))))
        if self._context is None or stamps != self._stamps:
            self._context, self._stamps = self._made(), stamps
        return self._context

    def _made(self) -> ssl.SSLContext:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_alpn_protocols([WORKER_ALPN, HTTP_ALPN])
        if self.ca is None:
            context.load_default_certs()
        else:
            load_authority(context, self.ca)
        if self.pair is not None:
            load_pair(context, *self.pair)
        return context

    def connection(self, *args: Any, **options: Any) -> ClientConnection:
        """Make the next one."""
        self._connection = _LinkConnection(*args, **options)
        return self._connection

    def fault(self, error: BaseException) -> str:
        """Return the fault of a handshake, and at which end it is; empty where TLS has none."""
        lost_by = self._connection.lost_by if self._connection else None
        errors = (*_causes(error), *_causes(lost_by))
        found = next((each for each in errors if isinstance(each, ssl.SSLError)), None)
        match found:
            case None:
                return ""
            case ssl.SSLCertVerificationError():
                return _of_dashboard(found)
        reason = getattr(found, "reason", None) or str(found)
        if reason in _NO_TLS:
            return "no TLS is spoken there: is --app to begin with http://?"
        if "ALERT" in reason:
            return f"the dashboard refused the certificate of this worker: {_of_alert(reason)}"
        return f"TLS failed: {_in_words(reason)}"


def _of_dashboard(error: ssl.SSLCertVerificationError) -> str:
    if error.verify_code in _UNKNOWN_AUTHORITY:
        return "the dashboard's certificate is of an unknown authority: give the ca.pem of its site as --ca"
    text = f"the dashboard's certificate cannot be verified: {error.verify_message}"
    return _OF_DASHBOARD.get(error.verify_code, text)


def _of_alert(reason: str) -> str:
    return next((text for name, text in _ALERTS.items() if reason.endswith(name)), _in_words(reason))


def _in_words(reason: str) -> str:
    return reason.lower().replace("_", " ")


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
