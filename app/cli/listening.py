"""Taking the dashboard's TCP port; it imports little, so that a port in use is reported at once."""

from __future__ import annotations

import errno
import socket

from bus.errors import LinesideError

BACKLOG = 512
"""Browsers of a whole plant come back at once after a restart."""


class ListenError(LinesideError):
    """The dashboard's port cannot be taken; the text says why and what to do."""


def listen(host: str, port: int, choose: str) -> socket.socket:
    """Take ``port`` of ``host``. ``choose``: how the caller chooses another port. Raises ListenError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    both = host == "::" and socket.has_dualstack_ipv6()
    try:
        return socket.create_server((host, port), family=family, backlog=BACKLOG, dualstack_ipv6=both)
    except (OSError, OverflowError) as error:
        raise ListenError(_reason(host, port, choose, error)) from error


def _reason(host: str, port: int, choose: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number is not None and number < 0:  # EAI_…: create_server passes on what getaddrinfo(3) returned
        return f"there is no host {host!r}. Set host in [server] to an address of this machine, or 0.0.0.0."
    match number:
        case errno.EADDRINUSE:
            return f"port {port} of {host} is in use by another program. End that program, or {choose}."
        case errno.EACCES:
            return f"port {port} of {host} is reserved for root. Take a port above 1023: {choose}."
        case errno.EADDRNOTAVAIL:
            return (
                f"{host} is no address of this machine. Set host in [server] to one that is, or to 0.0.0.0."
            )
        case _:
            words = getattr(error, "strerror", None) or error
            return f"port {port} of {host} cannot be opened: {words}. Check host and port in [server]."


def url_of(host: str, port: int) -> str:
    """Where a browser or a worker on this machine finds the dashboard that listens on ``host``."""
    if host == "0.0.0.0" or (host == "::" and socket.has_dualstack_ipv6()):
        host = "127.0.0.1"
    elif host == "::":
        host = "::1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
