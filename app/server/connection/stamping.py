"""Every request gets the moment at which its first byte arrived, before anything else happens to it."""

from __future__ import annotations

import asyncio
from typing import Any

from app.server.admission.turns import ARRIVED_AT
from app.server.connection.arrivals import ConnectionArrivals
from app.server.connection.http import HttpProtocol
from app.server.connection.tcp_wait import TcpSocket, tcp_wait
from app.server.loop_watch import LoopWatch


class StampingProtocol(HttpProtocol):
    """A command's time counts from the stamp (:mod:`app.web.admission.arrival`)."""

    _socket: TcpSocket | None = None
    _arrivals: ConnectionArrivals
    _arrived_at = 0.0

    def __init__(self, *args: Any, watch: LoopWatch, **more: Any) -> None:
        super().__init__(*args, **more)
        self._watch = watch

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """It may have been open for long: the kernel accepts without us."""
        now = self._watch.now()
        self._socket = transport.get_extra_info("socket")
        wait = tcp_wait(self._socket)
        opened_at = self._watch.polled_after if wait is None else now - wait.sent_s
        self._arrivals = ConnectionArrivals(opened_at, now)
        super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        """The bytes may have waited for long too."""
        if self.scheme != "https":
            self.arrived(len(data), is_first=True)
        super().data_received(data)
        if self.flow.read_paused:
            self._arrivals.paused()

    def arrived(self, size: int, *, is_first: bool) -> None:
        """Bytes were read from the socket."""
        # The clock first: whatever stops this process between the two makes the bytes older, never younger.
        now = self._watch.now()
        wait = tcp_wait(self._socket)
        arrived_at = self._arrivals.received(
            now,
            size,
            polled_after=self._watch.polled_after,
            waited_s=0.0 if wait is None else wait.received_s,
        )
        if is_first and not self._unparsed:
            self._arrived_at = arrived_at

    def left_in_kernel(self) -> None:
        """The TLS below has more than it decrypts in a turn."""
        self._arrivals.paused()

    def _hold_back(self) -> None:
        """What follows waits in the kernel."""
        self._arrivals.paused()
        super()._hold_back()

    def _read_on(self) -> None:
        """All that was received is parsed."""
        super()._read_on()
        if not self.flow.read_paused:
            self._arrivals.resumed(self._watch.now())

    def on_message_begin(self) -> None:
        """The first byte of a request, which may be the second of these bytes."""
        super().on_message_begin()
        self.scope["state"][ARRIVED_AT] = self._arrived_at

    def on_response_complete(self) -> None:
        """The next request may be read."""
        super().on_response_complete()
        self._arrivals.resumed(self._watch.now())
