"""Keeps the port open: waits for one that is absent or taken, notices a lost one and opens it again."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable

import structlog

from bus.errors import WireError
from bus.line.poller import Poller
from bus.line.port.open_port import open_port
from bus.line.port.port import EndedWhileOpening, OpenPort, Receiver
from bus.messages import Message
from bus.reconnect_delay import STABLE_S, ReconnectDelay, is_worth_logging

RETRY_S = 0.5
CHECK_S = 0.5
"""A lost port that nobody reported is noticed after so long."""

OpenFunction = Callable[[str, int, Receiver], Awaitable[OpenPort]]

_log = structlog.get_logger("bus.line")


class Opener:
    """Opens the poller's port, by its path anew each time, so a by-id link may point elsewhere by then."""

    def __init__(self, poller: Poller, open_function: OpenFunction = open_port) -> None:
        self._poller = poller
        self._open = open_function
        self._lost: asyncio.Future[Message] | None = None
        self._port: OpenPort | None = None
        self._cause: Message | None = None
        self._causes = 0
        """How often in a row another cause was seen than before."""
        self._lost_cause: Message | None = None
        self._backoff = ReconnectDelay(random.random)
        self._listener: _Listener | None = None
        poller.lost = self._is_lost

    async def run(self) -> None:
        """Until cancelled, which closes the port."""
        try:
            while True:
                pause_s = await self._open_until_lost()
                await asyncio.sleep(pause_s)
        finally:
            self.close()

    def close(self) -> None:
        """Give the port back."""
        if self._port is not None:
            self._port.close()
            self._port = None

    async def _open_until_lost(self) -> float:
        """One opening of the port, from its beginning to its end; in how many seconds to try the next."""
        clock, counts = self._poller.clock, self._poller.link.counts
        began, answers = clock.now(), counts.answers
        failure = await self._try()
        if failure is not None:
            return self._failed(failure, clock.now() - began)
        opened = clock.now()
        stable = asyncio.get_running_loop().call_later(STABLE_S, self._note_stable)
        await self._until_lost()
        stable.cancel()
        pause_s = self._backoff.ended(clock.now() - opened, useful=counts.answers > answers)
        self._log_closed(self._lost_cause)
        return pause_s

    def _failed(self, failure: WireError, took_s: float) -> float:
        """In how many seconds to try again; one that is absent is looked for twice a second."""
        pause_s = RETRY_S if took_s < RETRY_S else 0.0
        if isinstance(failure, EndedWhileOpening):
            pause_s = self._backoff.ended(0.0)
        self._log_closed(failure.message)
        self._poller.still_closed(failure.message)
        return pause_s

    async def _try(self) -> WireError | None:
        """Why it cannot be opened; None: it is open."""
        poller = self._poller
        self._lost = asyncio.get_running_loop().create_future()
        self._listener = _Listener(self)
        try:
            self._port = await self._open(poller.bus.port, poller.baud, self._listener)
        except WireError as error:
            return error
        self._cause = None
        if self._backoff.is_worth_logging:
            self._log_open()
        poller.port_opened(self._port)
        return None

    def _note_stable(self) -> None:
        """The opening that has lasted at last may have been none worth a line."""
        self._causes = 0
        if not self._backoff.is_worth_logging:
            self._log_open()

    def _log_open(self) -> None:
        _log.info("port open", port=self._poller.bus.port, baud=self._poller.baud)

    async def _until_lost(self) -> None:
        assert self._lost is not None
        while not self._lost.done():
            # Not wait_for(): of Python 3.11 it swallows a cancellation that comes as the port is lost.
            await asyncio.wait({self._lost}, timeout=CHECK_S)
            self._check()
        self.close()

    def _check(self) -> None:
        if self._port is None or self._lost is None or self._lost.done():
            return
        try:
            self._port.check()
        except WireError as error:
            self._poller.port_lost(error.message)

    def _is_lost(self, cause: Message) -> None:
        self._lost_cause = cause
        if self._lost is not None and not self._lost.done():
            self._lost.set_result(cause)

    def _log_closed(self, cause: Message | None) -> None:
        is_new, self._cause = cause not in (None, self._cause), cause
        self._causes += is_new
        if is_new and self._backoff.is_worth_logging and is_worth_logging(self._causes):
            _log.warning(
                "port closed; retrying", cause=str(cause), lost_soon_after_opening=self._backoff.count
            )

    def data_received(self, listener: _Listener, data: bytes) -> None:
        """Bytes of one opening; of an old one they mean nothing any more."""
        if listener is self._listener:
            self._poller.link.data_received(data)

    def ended(self, listener: _Listener, cause: Message) -> None:
        """One opening is over."""
        if listener is self._listener:
            self._poller.port_lost(cause)


class _Listener:
    """Hears one opening of the port."""

    def __init__(self, opener: Opener) -> None:
        self._opener = opener

    def data_received(self, data: bytes) -> None:
        self._opener.data_received(self, data)

    def connection_lost(self, cause: Message) -> None:
        self._opener.ended(self, cause)
