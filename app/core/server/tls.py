"""TLS: the server's certificate, which is replaced while the server runs when its files change, and the
records of one connection, bytes in and bytes out. Open connections keep their first certificate."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from app.core.server.settings import TlsSettings
from bus.instants import Clock, unix_now
from bus.messages import Message
from bus.tls import (
    HTTP_ALPN,
    WORKER_ALPN,
    Certificate,
    FileStamp,
    TlsFileError,
    date_fault,
    load_authority,
    load_pair,
    stamp_of,
)

HEADER_BYTES, MAX_HELLO_BYTES, HANDSHAKE = 5, 2**14, 22
"""Sizes and type of a record (RFC 8446, 5.1); the first one of a client is a part of its handshake."""
READ_BYTES = 2**16

ChooseContext = Callable[[bytes], ssl.SSLContext]
"""A function that returns the context for the first record of a client."""
LOOK_EVERY_S = 2.0
"""The seconds between checks of the files. Changed files are read once two checks find them equal, because
two files are never written at the same moment."""
OnReload = Callable[[Message, Message | None], Awaitable[None]]
"""A function called with the event and, if the files were refused, the reason."""


class NoTlsError(Exception):
    """Raised when the client does not speak TLS; ``is_text``: it may speak HTTP."""

    def __init__(self, first: int) -> None:
        super().__init__()
        self.is_text = chr(first).isascii() and chr(first).isalpha()


class TlsSession:
    """The TLS of one connection. Send the data of :meth:`take_outgoing` after each call, even after one that
    failed."""

    def __init__(self, choose_context: ChooseContext) -> None:
        self._choose_context = choose_context
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._hello = b""
        self._tls: ssl.SSLObject | None = None
        self.is_established = self.is_over = False
        """``is_over``: the client has announced its end."""

    def decrypt(self, data: bytes) -> bytes:
        """Decrypt received data, as far as it is complete. Raise ssl.SSLError and NoTlsError."""
        if self._tls is None:
            self._hello += data
            if not self._has_hello():
                return b""
            context, data = self._choose_context(self._hello), self._hello
            self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._incoming.write(data)
        parts = []
        with suppress(ssl.SSLWantReadError):
            if not self.is_established:
                self._tls.do_handshake()
                self.is_established = True
            while part := self._tls.read(READ_BYTES):
                parts.append(part)
            self.is_over = True
        return b"".join(parts)

    def encrypt(self, data: bytes) -> bytes:
        """Encrypt data as records of at most 16 KiB."""
        assert self._tls is not None
        left = memoryview(data)
        while left:
            left = left[self._tls.write(left) :]
        return self.take_outgoing()

    def end(self) -> bytes:
        """Announce the end of the session (RFC 8446, 6.1)."""
        if self._tls is not None and self.is_established:
            with suppress(ssl.SSLError):
                self._tls.unwrap()
        return self.take_outgoing()

    def take_outgoing(self) -> bytes:
        """Return the data to send besides payload: a part of the handshake, a key, an alert."""
        return self._outgoing.read()

    def is_certified(self) -> bool:
        """Return whether the client has shown a certificate that was verified."""
        return self._tls is not None and self.is_established and bool(self._tls.getpeercert())

    def _has_hello(self) -> bool:
        if self._hello[:1] != bytes([HANDSHAKE]):
            raise NoTlsError(self._hello[0])
        size = HEADER_BYTES + int.from_bytes(self._hello[3:HEADER_BYTES], "big")
        if size > HEADER_BYTES + MAX_HELLO_BYTES:
            raise ssl.SSLError(ssl.SSL_ERROR_SSL, "record too long")
        return len(self._hello) >= max(size, HEADER_BYTES)


@dataclass(frozen=True, slots=True)
class Contexts:
    """The TLS contexts of one state of the files. Only a client that announces itself as a worker is
    requested to show a certificate: a browser would let its user choose one, and some then open no
    WebSocket."""

    certificate: Certificate
    browsers: ssl.SSLContext
    workers: ssl.SSLContext


class ServerCertificate:
    """The certificate in use. Raises TlsFileError for files that cannot be used. An expired one can be used
    at the start: a page behind a warning is better than none."""

    def __init__(self, settings: TlsSettings, clock: Clock = unix_now) -> None:
        self._settings = settings
        self._clock = clock
        self._taken = self._seen = self._stamps()
        self._contexts = _read(settings)
        self._refusal: Message | None = None

    @property
    def fault(self) -> Message | None:
        """Why the certificate in the files is not used, or is not valid; None if neither is so."""
        file = self._settings.certificate
        return self._refusal or date_fault(self._contexts.certificate, file, self._clock())

    @property
    def ends_on(self) -> str:
        """The day on which the certificate in use ends."""
        return self._contexts.certificate.ends_on

    def context_for(self, client_hello: bytes) -> ssl.SSLContext:
        """Return the context for a client, by its first record."""
        is_worker = WORKER_ALPN.encode() in client_hello
        return self._contexts.workers if is_worker else self._contexts.browsers

    async def follow(self, on_reload: OnReload) -> None:
        """Look at the files every `LOOK_EVERY_S`, until canceled."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            await self.look(on_reload)

    async def look(self, on_reload: OnReload) -> None:
        """Look at the files once; use them if they have changed, but not since the last look."""
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
    """Read the files. Raise TlsFileError."""
    (browsers, certificate), (workers, _) = _context(settings), _context(settings)
    if settings.client_ca is not None:
        load_authority(workers, settings.client_ca)
        workers.verify_mode = ssl.CERT_OPTIONAL  # A client without one is refused in words, at /feed.
    return Contexts(certificate, browsers, workers)


def _context(settings: TlsSettings) -> tuple[ssl.SSLContext, Certificate]:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION
    context.set_alpn_protocols([HTTP_ALPN])
    return context, load_pair(context, settings.certificate, settings.key)


@runtime_checkable
class ServerEvents(Protocol):
    """The record of events about the server."""

    async def record(self, *, kind: Literal["server"], what: Message, message: Message | str) -> object:
        """Record an event. Raise StoreError."""


@dataclass(frozen=True)
class Encryption:
    """The encryption of connections. ``certificate``: that of HTTPS, if it is configured; ``is_missing``:
    other machines reach this one in clear."""

    certificate: ServerCertificate | None
    is_missing: bool

    @property
    def fault(self) -> Message | None:
        """The fault of the certificate, or that encryption is missing; None without either."""
        if self.certificate is not None:
            return self.certificate.fault
        return Message("tls_missing") if self.is_missing else None
