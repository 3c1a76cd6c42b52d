"""How long each certificate of a configuration is valid. The server's has its faults from `machine`,
authorities have them here."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from app.cli.findings.machine import Finding, fault
from app.cli.site.facts import CertificateFacts, certificate_facts
from app.conditions.of_server import DAY_S, certificate_expires
from app.settings import Settings
from bus.instants import UnixTime, unix_now
from bus.messages import Message
from bus.tls import TlsFileError, date_fault, read_certificate


def certificate_findings(settings: Settings) -> Iterator[Finding]:
    """Yield one finding for each file."""
    now, own = unix_now(), settings.server.tls and str(settings.server.tls.certificate)
    for each in certificate_facts(settings):
        if each.certificate is not None and not date_fault(each.certificate, Path(each.file), now):
            soon = certificate_expires(each.certificate.ends_at, now)
            days = int((each.certificate.ends_at - now) / DAY_S)
            code = "live_certificate_ends_soon" if soon else "live_certificate"
            yield Finding(Message.of(code, file=each.file, n=days, day=each.certificate.ends_on))
        elif each.file != own:
            yield fault("live_certificate_refused", reason=_refusal(each, now))


def _refusal(each: CertificateFacts, now: UnixTime) -> Message:
    """Why an authority cannot be used."""
    file = Path(each.file)
    try:
        certificate = each.certificate or read_certificate(file)
    except TlsFileError as error:
        return error.message
    return date_fault(certificate, file, now) or Message.of("tls_no_certificate", file=each.file)
