"""The checks at a start before many imports: the TCP port, and a store that can be used."""

from __future__ import annotations

import errno
import socket
from contextlib import suppress

from app.core.database.migration import presence_of, refusal_to_start
from app.errors import StoreError, system_error
from app.people.audit.keys import find_key_file
from app.settings import Settings
from bus.errors import LinesideError
from bus.messages import Message

BACKLOG = 512
"""The connections that may wait: all browsers of a plant reconnect at once after a restart."""
NEXT_PORTS = 10


class ListenError(LinesideError):
    """Raised if the dashboard's port cannot be taken; the text has the reason and the remedy."""


class PortInUse(ListenError):
    """Raised if another program has the port."""


def listen_from(host: str, first: int, choose: Message) -> socket.socket:
    """Take ``first`` of ``host``, or else the next free port. Raise ListenError."""
    for port in range(first, first + NEXT_PORTS):
        with suppress(PortInUse):
            return listen(host, port, choose)
    return listen(host, first, choose)


def listen(host: str, port: int, choose: Message) -> socket.socket:
    """Take ``port`` of ``host``. ``choose``: how a person chooses another port. Raise ListenError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    both = host == "::" and socket.has_dualstack_ipv6()
    try:
        return socket.create_server((host, port), family=family, backlog=BACKLOG, dualstack_ipv6=both)
    except (OSError, OverflowError) as error:
        in_use = getattr(error, "errno", None) == errno.EADDRINUSE
        raise (PortInUse if in_use else ListenError)(_reason(host, port, choose, error)) from error


def _reason(host: str, port: int, choose: Message, error: Exception) -> Message:
    number = getattr(error, "errno", None)
    if number is not None and number < 0:  # EAI_…: create_server passes on the number from getaddrinfo(3)
        return Message.of("listen_no_host", host=host)
    match number:
        case errno.EADDRINUSE:
            return Message.of("listen_port_in_use", port=port, host=host, choose=choose)
        case errno.EACCES:
            return Message.of("listen_port_reserved", port=port, host=host, choose=choose)
        case errno.EADDRNOTAVAIL:
            return Message.of("listen_foreign_address", host=host)
        case _:
            return Message.of("listen_failed", port=port, host=host, error=system_error(error))


def url_of(host: str, port: int, scheme: str = "http") -> str:
    """Return the URL by which a browser or a worker on this machine finds the dashboard that listens on
    ``host``."""
    if host == "0.0.0.0" or (host == "::" and socket.has_dualstack_ipv6()):
        host = "127.0.0.1"
    elif host == "::":
        host = "::1"
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


def check_store(settings: Settings, *, new: bool = False) -> None:
    """Raise StoreError if the main store is missing, empty or damaged and this is no first start; with
    ``new``, if there is a sound store."""
    store = settings.server.store
    refusal = refusal_to_start(store, presence_of(store), find_key_file(settings.key_files), new=new)
    if refusal is not None:
        raise StoreError(refusal)
