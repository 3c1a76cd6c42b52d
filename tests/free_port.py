"""A port for a server of the tests."""

from __future__ import annotations

import socket

_HELD: list[socket.socket] = []


def free_port() -> int:
    """Return a TCP port for a server of the tests, which no other socket is given while this process runs.

    It stays bound here, without listening. By SO_REUSEADDR, which servers set too, Linux lets one more socket
    bind it and listen, and chooses it neither for an outgoing connection nor for a socket that binds port 0:
    seconds can pass until the server of this port begins.
    """
    held = socket.socket()
    held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    held.bind(("127.0.0.1", 0))
    _HELD.append(held)
    return int(held.getsockname()[1])
