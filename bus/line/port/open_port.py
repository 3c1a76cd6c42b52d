"""Opening a port of any kind.

A port is single-use: it is opened, used, lost or closed, and then reopened by ``bus.line.opener``. Closing
never waits: what has not left yet is dropped, so nothing is ever sent late.
"""

from __future__ import annotations

from bus.line.port.device import open_device
from bus.line.port.port import OpenPort as OpenPort
from bus.line.port.port import Receiver as Receiver
from bus.line.port.rfc2217 import open_rfc2217
from bus.line.port.tcp import open_socket


async def open_port(port: str, baud: int, receiver: Receiver) -> OpenPort:
    """Open a device path, ``socket://host:port`` or ``rfc2217://host:port``. Raises PortUnavailable."""
    if port.startswith("socket://"):
        return await open_socket(port, receiver)
    if port.startswith("rfc2217://"):
        return await open_rfc2217(port, baud, receiver)
    return await open_device(port, baud, receiver)
