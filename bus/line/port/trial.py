"""Whether a port can be opened now: it is opened and given back at once, and not a byte is sent.

What uses a port must be known before: opening a serial port raises its control lines, and most device servers
take one connection only.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import termios

from bus.line.port.device import is_claimed
from bus.line.port.open_error import in_use, why_not
from bus.line.port.port import PortUnavailable
from bus.line.port.tcp import CONNECT_TIMEOUT_S, address_of, not_connected
from bus.messages import Message


def port_fault(port: str) -> Message | None:
    """Why a device or the device server of a URL cannot be opened now; None where it can."""
    try:
        if "://" in port:
            _connect(port)
        else:
            _open(port)
    except PortUnavailable as error:
        return error.message
    return None


def _open(path: str) -> None:
    """Its settings stay as they are: only their reading is tried. Raises PortUnavailable."""
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
    """Raises PortUnavailable."""
    try:
        socket.create_connection(address_of(url), timeout=CONNECT_TIMEOUT_S).close()
    except (OSError, UnicodeError) as error:
        raise PortUnavailable(not_connected(url, error)) from error
