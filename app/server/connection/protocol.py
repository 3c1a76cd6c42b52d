"""What connections of HTTP and of WebSockets have in common: they are counted, watched to their end, and take
turns at having their input parsed, one in each iteration of the event loop.

The kernel gives in one call what was sent in seconds, and a parser calls back for each piece of it: a chunk
of a body, a header, a frame, each of which may have a single byte. A turn therefore ends after so many bytes
or pieces. A connection whose input waits for its turn is not read.
"""

from __future__ import annotations

import asyncio
from typing import Any

from app.server.admission.addresses import source_of
from app.server.admission.refusal_log import RefusalLog
from app.server.admission.turns import LoopTurns
from app.server.connection.connections import Connection, Connections
from app.server.connection.pace import Backlog

CLOSING_S = 5.0
"""What a client gets to read the end of a connection."""
SLICE_BYTES = 512
"""Given to the parser at once: 85 empty frames or chunks of a byte."""
MAX_BYTES_A_TURN = 64 * 1024
"""Bytes of a body or a large message, which is few pieces, that one turn parses."""
MAX_PIECES_A_TURN = 64
"""Pieces after which a turn parses no further slice."""


class ConnectionProtocol(asyncio.Protocol):
    """To be inherited before a protocol of uvicorn, which parses; ``turns`` are those of all connections.
    ``connection`` is set before anything is received."""

    transport: asyncio.Transport
    connection: Connection

    def __init__(
        self,
        *args: object,
        open_connections: Connections,
        turns: LoopTurns,
        refusals: RefusalLog,
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self._open_connections = open_connections
        self._turns = turns
        self._refusals = refusals
        self._backlog = Backlog()
        self._closing_since: float | None = None
        self._unparsed = bytearray()
        self._pieces = 0
        self._awaits_turn = False
        self._holds_back = False
        self._is_heavy = False

    def data_received(self, data: bytes) -> None:
        """Take it in; it is parsed now where nothing was in this iteration of the loop, else in turn."""
        if self._takes_input(len(data)):
            self._unparsed += data
            self._go_on()

    def connection_lost(self, exc: Exception | None) -> None:
        self._open_connections.close(self.connection)
        self.connection.holder = None
        super().connection_lost(exc)

    def resume_writing(self) -> None:
        self._backlog = Backlog()
        super().resume_writing()

    # --- called by the TLS below ------------------------------------------------------------------------

    def arrived(self, size: int, *, is_first: bool) -> None:
        """Bytes have arrived that are received once they are decrypted. ``is_first``: none wait for that."""

    def left_in_kernel(self) -> None:
        """What arrives from now on is left in the kernel."""

    # --- as :class:`app.server.connection.client_connection.ClientConnection` -----------------------------

    def identify(self, account: str) -> None:
        self._open_connections.identify(self.connection, account)

    def is_certified(self) -> bool:
        return bool(self.transport.get_extra_info("peercert"))

    def trust(self) -> None:
        """Only a WebSocket has messages."""

    def write(self, _frame: bytes, /) -> bool:
        """Only a WebSocket has frames."""
        return False

    # --- of the protocol that parses -----------------------------------------------------------------

    def _parse(self, data: bytes) -> None:
        """Take a slice of the input."""
        raise NotImplementedError

    def _takes_input(self, size: int) -> bool:
        """Whether what is received is still of interest."""
        raise NotImplementedError

    def _is_ready(self) -> bool:
        """Whether the parser may have more now; where not, :meth:`_go_on` is called once it may."""
        raise NotImplementedError

    # --- of this one ----------------------------------------------------------------------------------

    def _is_at_its_end(self, now: float) -> bool:
        """Whether the connection is being closed, which is cut short where it takes too long."""
        if not self.transport.is_closing() and self._closing_since is None:
            return False
        self._closing_since = self._closing_since or now
        if now - self._closing_since > CLOSING_S:
            self.transport.abort()
        return True

    def _sender(self) -> str:
        """The account, or the address of a stranger: one with many connections has no more turns."""
        return self.connection.account or source_of(self.connection.address)

    def _go_on(self) -> None:
        """Parse what waits, in turn."""
        if self._unparsed and not self._awaits_turn and self._is_ready():
            self._awaits_turn = True
            self._turns.run((self._sender(), self._is_heavy), self._take_turn)
        if self._unparsed:
            self._hold_back()
        elif self._holds_back:
            self._read_on()

    def _take_turn(self) -> None:
        self._awaits_turn = False
        self._pieces, left = 0, MAX_BYTES_A_TURN
        while self._unparsed and left > 0 and self._pieces < MAX_PIECES_A_TURN and self._is_ready():
            part = bytes(self._unparsed[:SLICE_BYTES])
            del self._unparsed[:SLICE_BYTES]
            left -= len(part)
            self._parse(part)
        # What one turn was not enough for does not stand in front of the short requests of the same sender.
        self._is_heavy = bool(self._unparsed)
        self._go_on()

    def _drop_input(self) -> None:
        """Forget what waits."""
        self._unparsed.clear()
        self._go_on()

    def _hold_back(self) -> None:
        """Leave what follows in the kernel; again where uvicorn has resumed reading, which knows no turns."""
        self._holds_back = True
        self.transport.pause_reading()

    def _read_on(self) -> None:
        self._holds_back = False
        if self._is_ready():
            self.transport.resume_reading()
