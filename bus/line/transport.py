"""Opening a port and moving its bytes; the only module that knows the serial libraries.

A port is single-use: it is opened, used, lost or closed, and then opened anew by ``bus.line.opener``.
Closing never waits: what has not left yet is dropped, so nothing is ever sent late.
"""

from __future__ import annotations

import asyncio
import errno
import grp
import os
import pwd
import select
import socket
import termios
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import serial
import serial_asyncio

from bus.errors import WireError
from bus.line.holders import holders_of
from bus.line.port import OpenPort as OpenPort
from bus.line.port import PartlySent, PortUnavailable
from bus.line.port import Receiver as Receiver

CONNECT_TIMEOUT_S = 3.0
TCP_LOST_AFTER_MS = 800
"""Unacknowledged bytes for so long mean that the device server is gone."""
_TCP_USER_TIMEOUT = getattr(socket, "TCP_USER_TIMEOUT", 18)


async def open_port(port: str, baud: int, receiver: Receiver) -> OpenPort:
    """Open ``port`` (a device path, ``socket://host:port`` or ``rfc2217://host:port``).

    Raises PortUnavailable.
    """
    if port.startswith("socket://"):
        return await _open_socket(port, receiver)
    if port.startswith("rfc2217://"):
        return await _open_rfc2217(port, baud, receiver)
    return await _open_device(port, baud, receiver)


class _Protocol(asyncio.Protocol):
    """Between an asyncio transport and a Receiver."""

    def __init__(self, receiver: Receiver, gone: str) -> None:
        self.made: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.closed = False
        self._gone = gone
        self._receiver = receiver
        self.data_received = receiver.data_received  # type: ignore[method-assign]

    def connection_made(self, _transport: asyncio.BaseTransport) -> None:
        if not self.made.done():
            self.made.set_result(None)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.closed:
            self.closed = True
            self._receiver.connection_lost(f"{self._gone}{_reason(exc)}")


def _reason(exc: Exception | None) -> str:
    number = getattr(exc, "errno", None)
    return f" ({os.strerror(number)})" if number else ""


# --- a device path -------------------------------------------------------------------------------


class _Serial(serial.Serial):
    """pySerial as a loop needs it: reading looks once, not twice, and closing never waits."""

    def read(self, size: int = 1) -> bytes:
        """What is there. The loop has seen that there is something, so it is not asked for again."""
        try:
            data = os.read(self.fileno(), size)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise serial.SerialException(error.errno, os.strerror(error.errno or 0)) from error
        if not data and select.select([self], [], [], 0)[0]:
            raise serial.SerialException("it is ready and has nothing: it was pulled out")
        return data

    def flush(self) -> None:
        """pyserial-asyncio would wait on its loop until every byte has left."""
        with suppress(termios.error, serial.SerialException, OSError):
            self.reset_output_buffer()


class _Device:
    """A local serial port through pyserial-asyncio."""

    def __init__(self, transport: Any, protocol: _Protocol, descriptor: int, name: str) -> None:
        self._transport = transport
        self._protocol = protocol
        self._descriptor = descriptor
        self._name = name

    def write(self, data: bytes) -> None:
        """Straight to the descriptor: the transport would wait for the loop's next turn."""
        try:
            written = os.write(self._descriptor, data)
        except BlockingIOError as error:
            raise WireError(f"{self._name} takes no bytes: is its handshake line connected?") from error
        except OSError as error:
            raise WireError(f"{self._name} is gone ({os.strerror(error.errno or 0)})") from error
        if written != len(data):
            raise PartlySent(f"{self._name} took {written} of {len(data)} bytes")

    def listen(self, *, now: bool) -> None:
        if now:
            self._transport.resume_reading()
        else:
            self._transport.pause_reading()

    def drop_output(self) -> None:
        with suppress(termios.error, OSError):
            termios.tcflush(self._descriptor, termios.TCOFLUSH)

    def retune(self, baud: int) -> None:
        try:
            self._transport.serial.baudrate = baud
        except (serial.SerialException, termios.error, OSError, ValueError) as error:
            raise WireError(f"{self._name} cannot go to {baud} baud ({error})") from error

    def check(self) -> None:
        try:
            termios.tcgetattr(self._descriptor)
        except (termios.error, OSError) as error:
            raise WireError(f"{self._name} is gone: was the adapter pulled out?") from error

    def close(self) -> None:
        if self._protocol.closed:
            return
        self._protocol.closed = True
        self.drop_output()
        self._transport.abort()


async def _open_device(path: str, baud: int, receiver: Receiver) -> OpenPort:
    loop = asyncio.get_running_loop()
    try:
        instance = _Serial(path, baudrate=baud, timeout=0, write_timeout=0, exclusive=True)
    except (serial.SerialException, termios.error, OSError, ValueError) as error:
        raise PortUnavailable(_why_not(path, error)) from error
    _prefer_low_latency(instance)
    descriptor = instance.fileno()
    protocol = _Protocol(receiver, f"{path} is gone: was the adapter pulled out?")
    transport, _ = await serial_asyncio.connection_for_serial(loop, lambda: protocol, instance)
    await protocol.made
    return _Device(transport, protocol, descriptor, path)


def _prefer_low_latency(instance: _Serial) -> None:
    """An FTDI adapter would keep bytes for 16 ms; ports that know no such setting refuse it."""
    with suppress(ValueError, OSError, NotImplementedError, AttributeError):
        instance.set_low_latency_mode(True)


def _why_not(path: str, error: Exception) -> str:
    number = getattr(error, "errno", None) or _errno_in(error)
    if number == errno.ENOENT:
        return f"{path} is not there: is the adapter plugged in?{_others()}"
    if number in (errno.EACCES, errno.EPERM):
        return f"{path} may not be opened: {_permission_advice(path)}"
    if number in (errno.EAGAIN, errno.EBUSY):
        return f"{path} is in use{_by_whom(path)}"
    if number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR):
        return f"{path} is not a serial port"
    if number is not None:
        return f"{path} cannot be opened ({os.strerror(number)})"
    return f"{path} cannot be opened ({error})"


def _errno_in(error: Exception) -> int | None:
    """pySerial keeps the number of some errors only in what they were raised from."""
    for each in (error, error.__context__):
        if each is not None and each.args and isinstance(each.args[0], int):
            return each.args[0]
    return None


def _others() -> str:
    with suppress(OSError):
        names = sorted(str(entry) for entry in Path("/dev/serial/by-id").iterdir())
        if names:
            return f" There is: {', '.join(names)}"
    return ""


def _permission_advice(path: str) -> str:
    try:
        group = grp.getgrgid(Path(path).stat().st_gid).gr_name
        user = pwd.getpwuid(os.geteuid()).pw_name
    except (OSError, KeyError):
        return "the user that runs lineside needs the right to read and write it"
    return f"add the user to its group, 'sudo usermod -aG {group} {user}', and log in again"


def _by_whom(path: str) -> str:
    holders = holders_of(path)
    return f" by {', '.join(holders)}" if holders else " by another program"


# --- TCP -----------------------------------------------------------------------------------------


class _Stream:
    """A device server through asyncio's own transport."""

    def __init__(self, transport: Any, protocol: _Protocol, name: str) -> None:
        self._transport = transport
        self._protocol = protocol
        self._name = name

    def write(self, data: bytes) -> None:
        if self._transport.is_closing():
            raise WireError(f"{self._name} is gone")
        if self._transport.get_write_buffer_size() > 0:
            raise WireError(f"{self._name} takes no bytes")
        self._transport.write(data)

    def listen(self, *, now: bool) -> None:
        """A packet is no single byte: it is heard when it comes."""

    def drop_output(self) -> None:
        """The kernel's buffer cannot be emptied; a server that takes nothing is lost by its timeout."""

    def retune(self, baud: int) -> None:
        raise WireError(f"{self._name} has its own baud rate; {baud} is to be set in the device server")

    def check(self) -> None:
        if self._transport.is_closing():
            raise WireError(f"{self._name} is gone")

    def close(self) -> None:
        if not self._protocol.closed:
            self._protocol.closed = True
            self._transport.abort()


async def _open_socket(url: str, receiver: Receiver) -> OpenPort:
    host, number = _address(url)
    loop = asyncio.get_running_loop()
    protocol = _Protocol(receiver, f"{url} closed the connection")
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            transport, _ = await loop.create_connection(lambda: protocol, host, number)
    except TimeoutError as error:
        raise PortUnavailable(
            f"{url} does not answer: is the device server on, and its address right?"
        ) from error
    except ConnectionRefusedError as error:
        message = f"{url} refuses the connection: is its port number right, or is another host connected?"
        raise PortUnavailable(message) from error
    except OSError as error:
        raise PortUnavailable(f"{url} cannot be reached ({error.strerror or error})") from error
    _be_quick_to_notice(transport.get_extra_info("socket"))
    return _Stream(transport, protocol, url)


def _be_quick_to_notice(connection: socket.socket | None) -> None:
    if connection is None:
        return
    with suppress(OSError):
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option in ("TCP_KEEPIDLE", "TCP_KEEPINTVL", "TCP_KEEPCNT"):
            if hasattr(socket, option):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), 1)
        connection.setsockopt(socket.IPPROTO_TCP, _TCP_USER_TIMEOUT, TCP_LOST_AFTER_MS)


def _address(url: str) -> tuple[str, int]:
    parts = urlsplit(url)
    try:
        number = parts.port
    except ValueError:
        number = None
    if not parts.hostname or number is None:
        raise PortUnavailable(f"{url} needs a host and a port number, as in socket://192.168.1.20:4001")
    return parts.hostname, number


async def _open_rfc2217(url: str, baud: int, receiver: Receiver) -> OpenPort:
    try:
        import serialx
    except ImportError as error:
        raise PortUnavailable(f"{url} needs one more package: pip install 'lineside[rfc2217]'") from error
    _address(url)
    protocol = _Protocol(receiver, f"{url} closed the connection")
    kind = _rfc2217_transport()
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            transport, _ = await serialx.create_serial_connection(
                asyncio.get_running_loop(), lambda: protocol, url, baudrate=baud, transport_cls=kind
            )
            await protocol.made
    except TimeoutError as error:
        raise PortUnavailable(
            f"{url} does not answer: is the device server on, in RFC 2217 mode, and its address right?"
        ) from error
    except (OSError, ValueError) as error:
        raise PortUnavailable(f"{url} cannot be opened ({error})") from error
    return _Stream(transport, protocol, url)


def _rfc2217_transport() -> Any:
    """serialx's own, which takes servers as they are.

    Many never acknowledge the masks of line and modem states (RFC 2217, 3), which mean nothing on RS-422, and
    many speak first: what they say before the connection is known to be there would be an error.
    """
    from serialx.platforms.serial_rfc2217 import RFC2217SerialTransport
    from serialx.platforms.serial_rfc2217.types import SetLinestateMaskCmd, SetModemstateMaskCmd

    class Transport(RFC2217SerialTransport):  # type: ignore[misc, unused-ignore]
        _said_first = b""

        def _data_received(self, data: bytes) -> None:
            if self._tcp_transport is None:
                self._said_first += data
            else:
                super()._data_received(data)

        async def _negotiate(self) -> None:
            assert self._tcp_transport is not None
            _be_quick_to_notice(self._tcp_transport.get_extra_info("socket"))
            super()._data_received(self._said_first)
            await super()._negotiate()

        async def _send_and_wait(self, command: Any) -> Any:
            if isinstance(command, SetLinestateMaskCmd | SetModemstateMaskCmd):
                self._send_command(command)
                return command
            return await super()._send_and_wait(command)

    return Transport
