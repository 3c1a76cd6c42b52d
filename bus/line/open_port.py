"""Opens a port of any kind, or only tries whether it can be opened.

A port is single-use: it is opened, used, lost or closed, and then reopened by ``bus.line.opener``. Closing
never waits: what has not left yet is dropped, so nothing is ever sent late.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import termios

from bus.line.device import is_claimed, open_device
from bus.line.device_server import CONNECT_TIMEOUT_S, address_of, not_connected, open_rfc2217, open_socket
from bus.line.port import OpenPort as OpenPort
from bus.line.port import PortUnavailable, in_use, why_not
from bus.line.port import Receiver as Receiver
from bus.messages import Message


async def open_port(port: str, baud: int, receiver: Receiver) -> OpenPort:
    """Open a device path, ``socket://host:port`` or ``rfc2217://host:port``. Raises PortUnavailable."""
    if port.startswith("socket://"):
        return await open_socket(port, receiver)
    if port.startswith("rfc2217://"):
        return await open_rfc2217(port, baud, receiver)
    return await open_device(port, baud, receiver)


def port_fault(port: str) -> Message | None:
    """Return why a device or the device server of a URL cannot be opened now, or None where it can."""
    try:
        if "://" in port:
            _connect(port)
        else:
            _open(port)
    except PortUnavailable as error:
        return error.message
    return None


def _open(path: str) -> None:
    """Open a device and read its settings, which stay as they are. Raises PortUnavailable."""
    try:
        # Else a port that waits for a carrier would block, and one without a terminal's user become it.
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
    """Connect to a device server. Raises PortUnavailable."""
    try:
        socket.create_connection(address_of(url), timeout=CONNECT_TIMEOUT_S).close()
    except (OSError, UnicodeError) as error:
        raise PortUnavailable(not_connected(url, error)) from error
