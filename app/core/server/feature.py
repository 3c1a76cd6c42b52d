"""The encryption of the server: none, or TLS by a certificate that is replaced when its files change."""

from __future__ import annotations

from functools import partial

import structlog

from app.core.server.tls import Encryption, ServerCertificate, ServerEvents
from app.feature import Feature, Services
from bus.messages import Message

_log = structlog.get_logger()


def make(services: Services) -> None:
    server, certificate = services.settings.server, None
    if server.tls is not None:
        certificate = ServerCertificate(server.tls)
        services.lifespan.add(
            "certificate", partial(certificate.follow, partial(_record, services[ServerEvents]))
        )
    encryption = services.add(Encryption(certificate, is_missing=server.is_in_clear))
    if encryption.fault is not None:
        _log.warning("certificate" if certificate else "not encrypted", why=str(encryption.fault))


async def _record(events: ServerEvents, what: Message, fault: Message | None) -> None:
    """Record an event about the certificate."""
    log = _log.info if fault is None else _log.warning
    log(str(what), **({} if fault is None else {"why": str(fault)}))
    await events.record(kind="server", what=what, message=fault or "")


FEATURE = Feature(make)
