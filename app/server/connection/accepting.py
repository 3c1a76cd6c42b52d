"""Accepts few connections in each iteration of the event loop.

``create_server`` accepts all that wait at once, and begins with the request of each in the next iteration: a
burst of some hundred stands in front of a command that arrives on a connection that is open already. One at a
time, the burst stands in front of the next connection of someone else.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from itertools import count

MAX_AT_ONCE = 8
"""To accept one takes the event loop a tenth of a millisecond; its request then waits for its turn."""
RECEIVE_BUFFER_BYTES = 64 * 1024
"""What the system takes of a connection before this process reads it. A protocol gets it in one call: it is
also what waits here for its turn to be parsed."""
NO_ROOM_S = 0.1
"""How long nothing is accepted after the system had no room for a connection (accept(2): EMFILE, ENOMEM)."""


async def accept_connections(listening: socket.socket, make_protocol: Callable[[], asyncio.Protocol]) -> None:
    """Serve each connection with a new protocol, until canceled."""
    loop = asyncio.get_running_loop()
    listening.setblocking(False)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)  # inherited
    for number in count(1):
        try:
            connection, _ = await loop.sock_accept(listening)
        except ConnectionError:
            continue  # the client was gone before it was accepted
        except OSError:
            await asyncio.sleep(NO_ROOM_S)
            continue
        try:
            await _begin(connection, make_protocol)
        finally:
            if not number % MAX_AT_ONCE:  # uvloop returns from sock_accept at once where a connection waits
                await asyncio.sleep(0)


async def _begin(connection: socket.socket, make_protocol: Callable[[], asyncio.Protocol]) -> None:
    with suppress(OSError):
        connection.setblocking(False)
        await asyncio.get_running_loop().connect_accepted_socket(make_protocol, connection)
