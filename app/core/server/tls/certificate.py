"""The certificate of HTTPS, replaced while the server runs when its files change.

New connections take the new one; those that are open keep theirs.
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from app.core.server.settings import TlsSettings
from bus.certificate import Certificate
from bus.instants import Clock, unix_now
from bus.messages import Message
from bus.tls import (
    HTTP_ALPN,
    WORKER_ALPN,
    FileStamp,
    TlsFileError,
    date_fault,
    load_authority,
    load_pair,
    stamp_of,
)

LOOK_EVERY_S = 2.0
"""Files that have changed are read once two looks agree: two files are never written at once."""
OnReload = Callable[[Message, Message | None], Awaitable[None]]
"""Called with what happened and, where the files were refused, the reason."""


@dataclass(frozen=True, slots=True)
class Contexts:
    """The TLS contexts of one state of the files. Only a client that announces itself as a worker is
    requested to show a certificate: a browser would let its user choose one, and some open no WebSocket
    then."""

    certificate: Certificate
    browsers: ssl.SSLContext
    workers: ssl.SSLContext


class ServerCertificate:
    """The certificate in use. Raises TlsFileError for files that cannot be used. An expired one can, at the
    start: a page behind a warning is better than none."""

    def __init__(self, settings: TlsSettings, clock: Clock = unix_now) -> None:
        self._settings = settings
        self._clock = clock
        self._taken = self._seen = self._stamps()
        self._contexts = _read(settings)
        self._refusal: Message | None = None

    @property
    def fault(self) -> Message | None:
        """Why the certificate in the files is not used, or is not valid."""
        file = self._settings.certificate
        return self._refusal or date_fault(self._contexts.certificate, file, self._clock())

    def context_for(self, client_hello: bytes) -> ssl.SSLContext:
        """Return the context for a client by its first record."""
        is_worker = WORKER_ALPN.encode() in client_hello
        return self._contexts.workers if is_worker else self._contexts.browsers

    async def follow(self, on_reload: OnReload) -> None:
        """Look at the files again and again, without end."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            await self.look(on_reload)

    async def look(self, on_reload: OnReload) -> None:
        """Look at the files once; use what has changed and was found the same before."""
        found, before = await asyncio.to_thread(self._stamps), self._seen
        self._seen = found
        if found == self._taken or found != before:
            return
        self._taken = found
        try:
            self._contexts = await asyncio.to_thread(self._read_valid)
        except TlsFileError as error:
            self._refusal = error.message
            await on_reload(Message("event_certificate_refused"), error.message)
        else:
            self._refusal = None
            day = self._contexts.certificate.ends_on
            await on_reload(Message.of("event_certificate_reloaded", day=day), None)

    def _read_valid(self) -> Contexts:
        contexts = _read(self._settings)
        if fault := date_fault(contexts.certificate, self._settings.certificate, self._clock()):
            raise TlsFileError(fault)
        return contexts

    def _stamps(self) -> tuple[FileStamp, ...]:
        return tuple(map(stamp_of, self._settings.files))


def _read(settings: TlsSettings) -> Contexts:
    """Read the files. Raises TlsFileError."""
    (browsers, certificate), (workers, _) = _context(settings), _context(settings)
    if settings.client_ca is not None:
        load_authority(workers, settings.client_ca)
        workers.verify_mode = ssl.CERT_OPTIONAL  # one without is refused in words, at /feed
    return Contexts(certificate, browsers, workers)


def _context(settings: TlsSettings) -> tuple[ssl.SSLContext, Certificate]:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION
    context.set_alpn_protocols([HTTP_ALPN])
    return context, load_pair(context, settings.certificate, settings.key)
