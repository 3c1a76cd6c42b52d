"""Whether the provider of company accounts that a configuration names can be used from this machine."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

from app.auth.oidc.single_sign_on import provider_of, require_package
from app.auth.settings import OidcSettings
from app.cli.findings.machine import Finding
from app.server.secret_file import SecretFileError, can_others_read, read_secret_text
from bus.errors import LinesideError
from bus.messages import Message


def oidc_findings(settings: OidcSettings | None) -> Iterator[Finding]:
    """The package, the file of the secret, and the provider, which is only read."""
    if settings is None:
        return
    try:
        require_package()
    except LinesideError as error:
        yield Finding(error.message, is_fault=True)
        return
    try:
        read_secret_text(settings.client_secret_file)
    except SecretFileError as error:
        yield Finding(error.message, is_fault=True)
    if can_others_read(settings.client_secret_file):
        yield Finding(Message.of("check_secret_open", path=str(settings.client_secret_file)))
    fault = asyncio.run(_fault_of(settings))
    if fault is not None:
        message = Message.of("check_oidc_failed", issuer=settings.issuer, reason=fault)
        yield Finding(message, is_fault=True)
    else:
        yield Finding(Message.of("check_oidc", issuer=settings.issuer))


async def _fault_of(settings: OidcSettings) -> Message | None:
    provider = provider_of(settings)
    try:
        await provider.refresh()
    finally:
        await provider.close()
    return provider.fault
