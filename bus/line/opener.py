"""The port of a line: opened, only tried, or kept open. An absent or occupied port is waited for, a lost one
reopened.

An open port is single-use: it is opened, used, lost or closed, and then reopened. Closing never waits: bytes
that have not left yet are dropped, so nothing is ever sent late.
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import math
import os
import random
import socket
import termios
from collections.abc import Awaitable, Callable

import structlog

from bus.errors import WireError
from bus.instants import Monotonic
from bus.line.device import is_claimed, open_device
from bus.line.device_server import CONNECT_TIMEOUT_S, address_of, not_connected, open_rfc2217, open_socket
from bus.line.line_loop import LineLoop
from bus.line.port import (
    EndedWhileOpening,
    PortUnavailable,
    in_use,
    is_device,
    programs_of,
    users_of,
    why_not,
)
from bus.line.port import OpenPort as OpenPort
from bus.line.port import Receiver as Receiver
from bus.messages import Message
from bus.pacing import STABLE_S, ReconnectDelay, is_worth_logging


async def open_port(port: str, baud: int, receiver: Receiver) -> OpenPort:
    """Open a device path, ``socket://host:port`` or ``rfc2217://host:port``. Raise PortUnavailable."""
    if port.startswith("socket://"):
        return await open_socket(port, receiver)
    if port.startswith("rfc2217://"):
        return await open_rfc2217(port, baud, receiver)
    return await open_device(port, baud, receiver)


def port_fault(port: str) -> Message | None:
    """Return why a device or device server (URL) cannot be opened now, or None if it can."""
    try:
        if "://" in port:
            _connect(port)
        else:
            _open(port)
    except PortUnavailable as error:
        return error.message
    return None


def _open(path: str) -> None:
    """Open a device and read its settings without changing them. Raise PortUnavailable if that fails."""
    try:
        # Without these flags a port that waits for a carrier would block, or become the controlling terminal.
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise PortUnavailable(why_not(path, error)) from error
    try:
        termios.tcgetattr(descriptor)
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except termios.error as error:
        raise PortUnavailable(why_not(path, OSError(errno.ENOTTY, ""))) from error
    except OSError as error:
        raise PortUnavailable(why_not(path, error)) from error
    else:
        if is_claimed(descriptor, path):
            raise PortUnavailable(in_use(path))
    finally:
        os.close(descriptor)


def _connect(url: str) -> None:
    """Connect to a device server. Raise PortUnavailable if that fails."""
    try:
        socket.create_connection(address_of(url), timeout=CONNECT_TIMEOUT_S).close()
    except (OSError, UnicodeError) as error:
        raise PortUnavailable(not_connected(url, error)) from error


RETRY_S = 0.5
CHECK_S = 0.5
"""The seconds between checks of an open port, within which a loss that is not reported is detected."""
OTHERS_S = 60.0
"""Seconds between searches for other users of the port; one follows when a unit stops responding."""
REMARK_S = 600.0
"""The seconds for which the diagnosis shows that another program changed the port's settings."""

OpenFunction = Callable[[str, int, Receiver], Awaitable[OpenPort]]

_log = structlog.get_logger("bus.line")


class Opener:
    """The opener of the line's port. The path is opened anew each time, so that a by-id link may point to
    another device."""

    def __init__(self, line: LineLoop, open_function: OpenFunction = open_port) -> None:
        self._line = line
        self._open = open_function
        self._port: OpenPort | None = None
        self._cause: Message | None = None
        self._causes = 0
        """The number of times in a row that the cause differed from the one before."""
        self._backoff = ReconnectDelay(random.random)
        self.opening: _Opening | None = None

    async def run(self) -> None:
        """Keep the port open until cancelled, which closes it."""
        try:
            while True:
                pause_s = await self._open_until_lost()
                await asyncio.sleep(pause_s)
        finally:
            self.close()

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    async def _open_until_lost(self) -> float:
        """Open the port once and use it until it is lost; return the seconds until it is reopened."""
        clock = self._line.clock
        began = clock.now()
        self.opening = opening = _Opening(self, self._line)
        try:
            self._port = await self._open(self._line.bus.port, self._line.baud, opening)
            opening.check()
        except WireError as error:
            self.close()
            return self._failed(error, clock.now() - began)
        self._cause = None
        if self._backoff.is_worth_logging:
            self._log_open()
        opened = clock.now()
        stable = asyncio.get_running_loop().call_later(STABLE_S, self._note_stable)
        checking = asyncio.create_task(self._check(self._port))
        try:
            cause = await self._line.run(self._port)
        finally:
            checking.cancel()
        stable.cancel()
        self.close()
        pause_s = self._backoff.ended(clock.now() - opened, useful=self._line.link.has_responses)
        self._log_closed(cause)
        return pause_s

    def _failed(self, failure: WireError, took_s: float) -> float:
        """Return the seconds until the next attempt; an absent port is tried twice a second."""
        pause_s = RETRY_S if took_s < RETRY_S else 0.0
        if isinstance(failure, EndedWhileOpening):
            pause_s = self._backoff.ended(0.0)
        self._log_closed(failure.message)
        self._line.still_closed(failure.message)
        return pause_s

    async def _check(self, port: OpenPort) -> None:
        """Detect that the port is lost, or that another program uses it or changed its settings."""
        silent: frozenset[int] = frozenset()
        looked_at = Monotonic(-math.inf)
        while True:
            await asyncio.sleep(CHECK_S)
            try:
                changed = port.check()
            except WireError as error:
                self._line.lose_port(error.message)
                continue
            before, silent = silent, self._line.roster.unresponsive
            if changed or silent - before or self._line.clock.now() - looked_at >= OTHERS_S:
                looked_at = self._line.clock.now()
                await self._note_others(changed)

    async def _note_others(self, changed: list[str]) -> None:
        """Report which other programs have the port open, and which settings one of them has ``changed``."""
        path = self._line.bus.port
        if not is_device(path):
            return
        # A thread does this, because hundreds of processes may have thousands of files open.
        programs = programs_of(await asyncio.to_thread(users_of, path))
        if changed:
            _log.warning("another program changed the settings of the port", port=path, changed=changed)
            code = "diagnosis_port_changed_by" if programs else "diagnosis_port_changed"
            remark = Message.of(code, changed=changed, programs=programs)
            self._line.note_port(remark, about=f"{changed}", lasts_s=REMARK_S)
        if programs:
            remark = Message.of("diagnosis_port_shared", programs=programs)
            self._line.note_port(remark, about=f"{remark}", lasts_s=OTHERS_S + 2 * CHECK_S)

    def _note_stable(self) -> None:
        """Log an opening that lasts, even if the ones before were too short to be logged."""
        self._causes = 0
        self._line.port_is_back()
        if not self._backoff.is_worth_logging:
            self._log_open()

    def _log_open(self) -> None:
        _log.info("port open", port=self._line.bus.port, baud=self._line.baud)

    def _log_closed(self, cause: Message) -> None:
        is_new, self._cause = cause != self._cause, cause
        self._causes += is_new
        if is_new and self._backoff.is_worth_logging and is_worth_logging(self._causes):
            _log.warning(
                "port closed; retrying", cause=str(cause), lost_soon_after_opening=self._backoff.count
            )


class _Opening:
    """The receiver of one opening of the port; bytes that an earlier opening still delivers are ignored."""

    def __init__(self, opener: Opener, line: LineLoop) -> None:
        self._opener = opener
        self._line = line
        self._loss: Message | None = None

    def check(self) -> None:
        """Raise EndedWhileOpening if the connection has been lost already."""
        if self._loss is not None:
            raise EndedWhileOpening(self._loss)

    def data_received(self, data: bytes) -> None:
        if self._opener.opening is self:
            self._line.link.data_received(data)

    def connection_lost(self, cause: Message) -> None:
        self._loss = cause
        if self._opener.opening is self:
            self._line.lose_port(cause)
