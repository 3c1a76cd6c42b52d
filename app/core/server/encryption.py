"""States whether what passes between browsers, workers and this server is encrypted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bus.messages import Message

if TYPE_CHECKING:  # it imports what a server without TLS does not need
    from app.core.server.tls.certificate import ServerCertificate


@dataclass(frozen=True)
class Encryption:
    """``certificate``: of HTTPS, where it is configured. ``is_missing``: other machines reach this one
    without it."""

    certificate: ServerCertificate | None
    is_missing: bool

    @property
    def fault(self) -> Message | None:
        """Return the fault of the certificate, or that encryption is missing; None where neither is so."""
        if self.certificate is not None:
            return self.certificate.fault
        return Message("tls_missing") if self.is_missing else None
