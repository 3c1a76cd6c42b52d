"""A port for a server of the tests."""

from __future__ import annotations

import socket

_HELD: list[socket.socket] = []


def free_port() -> int:
    """Return a TCP port for a server of the tests: nobody else is given it as long as this process runs.

    It stays bound here, without listening. By SO_REUSEADDR, which servers set too, Linux lets one more socket
    bind it and listen, and takes it neither for a connection that goes out nor for whoever asks for any port:
    seconds can pass until the server that is to have it begins.
    """
    held = socket.socket()
    held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    held.bind(("127.0.0.1", 0))
    _HELD.append(held)
    return int(held.getsockname()[1])
