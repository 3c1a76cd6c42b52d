"""Keeps the port open: waits for one that is absent or taken, notices a lost one, opens it anew for ever."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

import structlog

from bus.errors import WireError
from bus.line.poller import Poller
from bus.line.port import OpenPort, Receiver
from bus.line.transport import open_port

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
        self._lost: asyncio.Future[str] | None = None
        self._port: OpenPort | None = None
        self._cause = ""
        self._listener: _Listener | None = None
        poller.lost = self._is_lost

    async def run(self) -> None:
        """Until cancelled, which closes the port."""
        try:
            while True:
                began = self._poller.clock.now()
                if await self._try():
                    await self._until_lost()
                if self._poller.clock.now() - began < RETRY_S:
                    await asyncio.sleep(RETRY_S)
        finally:
            self.close()

    def close(self) -> None:
        """Give the port back."""
        if self._port is not None:
            self._port.close()
            self._port = None

    async def _try(self) -> bool:
        poller = self._poller
        self._lost = asyncio.get_running_loop().create_future()
        self._listener = _Listener(self)
        try:
            self._port = await self._open(poller.bus.port, poller.baud, self._listener)
        except WireError as error:
            self._tell(str(error))
            poller.still_closed(str(error))
            return False
        self._cause = ""
        _log.info("port open", port=poller.bus.port, baud=poller.baud)
        poller.port_opened(self._port)
        return True

    async def _until_lost(self) -> None:
        assert self._lost is not None
        while not self._lost.done():
            with suppress(TimeoutError):
                await asyncio.wait_for(asyncio.shield(self._lost), CHECK_S)
            self._check()
        self.close()

    def _check(self) -> None:
        if self._port is None or self._lost is None or self._lost.done():
            return
        try:
            self._port.check()
        except WireError as error:
            self._poller.port_lost(str(error))

    def _is_lost(self, cause: str) -> None:
        self._tell(cause)
        if self._lost is not None and not self._lost.done():
            self._lost.set_result(cause)

    def _tell(self, cause: str) -> None:
        if cause and cause != self._cause:
            _log.warning("port closed; it is tried again until it is there", cause=cause)
        self._cause = cause

    def heard(self, listener: _Listener, data: bytes) -> None:
        """Bytes of one opening; of an old one they mean nothing any more."""
        if listener is self._listener:
            self._poller.link.data_received(data)

    def ended(self, listener: _Listener, cause: str) -> None:
        """One opening is over."""
        if listener is self._listener:
            self._poller.port_lost(cause)


class _Listener:
    """Hears one opening of the port."""

    def __init__(self, opener: Opener) -> None:
        self._opener = opener

    def data_received(self, data: bytes) -> None:
        self._opener.heard(self, data)

    def connection_lost(self, cause: str) -> None:
        self._opener.ended(self, cause)
