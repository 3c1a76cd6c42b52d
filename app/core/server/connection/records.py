"""The records of one TLS connection, by the module ssl: bytes in, bytes out."""

from __future__ import annotations

import ssl
from collections.abc import Callable
from contextlib import suppress

HEADER_BYTES, MAX_HELLO_BYTES, HANDSHAKE = 5, 2**14, 22
"""Of a record (RFC 8446, 5.1); the first of a client is a part of its handshake."""
READ_BYTES = 2**16

ChooseContext = Callable[[bytes], ssl.SSLContext]
"""The context for the first record of a client."""


class NoTlsError(Exception):
    """What the client sends is no TLS; ``is_text``: it may be HTTP."""

    def __init__(self, first: int) -> None:
        super().__init__()
        self.is_text = chr(first).isascii() and chr(first).isalpha()


class TlsSession:
    """One connection. What :meth:`take_outgoing` returns is to be sent after each call, failed ones too."""

    def __init__(self, choose_context: ChooseContext) -> None:
        self._choose_context = choose_context
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._hello = b""
        self._header, self._body_left = b"", 0
        self._tls: ssl.SSLObject | None = None
        self.is_established = self.is_over = False
        """``is_over``: the client has announced its end."""

    def decrypt(self, data: bytes) -> bytes:
        """Decrypt what was received, as far as it is complete. Raises ssl.SSLError and NoTlsError."""
        if self._tls is None:
            self._hello += data
            if not self._has_hello():
                return b""
            context, data = self._choose_context(self._hello), self._hello
            self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._incoming.write(data)
        self._follow(data)
        parts = []
        with suppress(ssl.SSLWantReadError):
            if not self.is_established:
                self._tls.do_handshake()
                self.is_established = True
            while part := self._tls.read(READ_BYTES):
                parts.append(part)
            self.is_over = True
        return b"".join(parts)

    @property
    def is_within_record(self) -> bool:
        """Whether what was given last ends within a record."""
        return bool(self._header or self._body_left)

    def _follow(self, data: bytes) -> None:
        while data:
            if not self._body_left:
                missing = HEADER_BYTES - len(self._header)
                self._header, data = self._header + data[:missing], data[missing:]
                if len(self._header) < HEADER_BYTES:
                    return
                self._body_left, self._header = int.from_bytes(self._header[3:], "big"), b""
            passed = min(self._body_left, len(data))
            self._body_left, data = self._body_left - passed, data[passed:]

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
        """Return what is to be sent besides data: a part of the handshake, a key, an alert."""
        return self._outgoing.read()

    def is_certified(self) -> bool:
        """Whether the client has shown a certificate that was verified."""
        return self._tls is not None and self.is_established and bool(self._tls.getpeercert())

    def _has_hello(self) -> bool:
        if self._hello[:1] != bytes([HANDSHAKE]):
            raise NoTlsError(self._hello[0])
        size = HEADER_BYTES + int.from_bytes(self._hello[3:HEADER_BYTES], "big")
        if size > HEADER_BYTES + MAX_HELLO_BYTES:
            raise ssl.SSLError(ssl.SSL_ERROR_SSL, "record too long")
        return len(self._hello) >= max(size, HEADER_BYTES)
