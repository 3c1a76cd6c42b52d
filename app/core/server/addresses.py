"""Network addresses as limits and logs see them, and the client of a request behind proxies.

X-Forwarded-For, -Proto and -Host are believed from trusted proxies only: the address reaches the audit log
and the limits of sign-ins.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import lru_cache
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Receive, Scope, Send

from app.core.server.refusals import TOO_MANY_REQUESTS

Address = IPv4Address | IPv6Address
Network = IPv4Network | IPv6Network

SUBNET_BITS = 64
"""The prefix of an IPv6 subnet, which one subscriber or one machine has at least (RFC 6177, 2)."""
MAX_REMEMBERED = 1024
MAX_HOPS = 20
MAX_UNDER_WAY = 200
"""The most requests of one address behind a proxy; all browsers of a plant may share one."""
_PORT = re.compile(r"(?:\[(?P<v6>[^\]]*)\]|(?P<v4>[^:]*))(?::\d{1,5})?")
_HOST = re.compile(r"[A-Za-z0-9._-]{1,253}(?::\d{1,5})?|\[[0-9A-Fa-f:.]{2,45}\](?::\d{1,5})?")
_SOCKET_SCHEMES = {"http": "ws", "https": "wss"}


@lru_cache(maxsize=MAX_REMEMBERED)
def _parse_address(text: str) -> Address | None:
    """Parse an address; an IPv4 address also in the form of a dual-stack socket, ``::ffff:10.0.0.5``."""
    try:
        address = ip_address(text)
    except ValueError:
        return None
    return getattr(address, "ipv4_mapped", None) or address


def canonical(text: str) -> str:
    """Return an address in its usual form; any other text unchanged."""
    return str(_parse_address(text) or text)


@lru_cache(maxsize=MAX_REMEMBERED)
def source_of(text: str) -> str:
    """Return the key by which a client is counted: an IPv4 address, the /64 of an IPv6 address, or any other
    text unchanged."""
    address = _parse_address(text)
    if isinstance(address, IPv6Address):
        return str(ip_network((int(address) >> SUBNET_BITS << SUBNET_BITS, SUBNET_BITS)))
    return str(address or text)


def is_within(text: str, networks: Collection[Network]) -> bool:
    """Return whether the address belongs to one of the networks."""
    address = _parse_address(text)
    return address is not None and any(address in network for network in networks)


@dataclass(frozen=True, slots=True)
class Origin:
    """The client that a trusted proxy reports; ``scheme`` and ``host`` are empty if they are not reported."""

    address: str
    scheme: str = ""
    host: str = ""


def origin_of(peer: str, headers: Headers, trusted: Collection[Network]) -> Origin:
    """Return the client of a request. ``peer``: the other end of the connection, believed only if it is
    ``trusted``.

    Each proxy appends the address of its client, so the right-most address that is not a trusted proxy is the
    client's; anything to the left of it can be made up.
    """
    if not is_within(peer, trusted):
        return Origin(canonical(peer))
    scheme = _last(headers, "x-forwarded-proto").lower()
    host = _last(headers, "x-forwarded-host")
    return Origin(
        _client(peer, ",".join(headers.getlist("x-forwarded-for")), trusted),
        scheme if scheme in _SOCKET_SCHEMES else "",
        host if _HOST.fullmatch(host) else "",
    )


def _client(peer: str, forwarded_for: str, trusted: Collection[Network]) -> str:
    client = peer
    for hop in reversed(forwarded_for.rsplit(",", MAX_HOPS)[-MAX_HOPS:]):
        address = _parse_address(_without_port(hop.strip()))
        if address is None:
            break
        client = str(address)
        if not is_within(client, trusted):
            break
    return canonical(client)


def _without_port(text: str) -> str:
    found = _PORT.fullmatch(text)
    return (found["v6"] or found["v4"] or "") if found else text


def _last(headers: Headers, name: str) -> str:
    return ",".join(headers.getlist(name)).rpartition(",")[2].strip()


class Forwarded:
    """The ASGI middleware that puts the client of a request, and the name by which it called this server,
    into the scope. A proxy's connections carry requests of many clients, so the requests of each are counted
    here as other connections are (`app.core.server.connections`). ``note_refusal`` is called with the
    address, the status and the path of a request too many."""

    def __init__(
        self, app: ASGIApp, trusted: Collection[Network], note_refusal: Callable[[str, str, str], None]
    ) -> None:
        self._app = app
        self._trusted = trusted
        self._note_refusal = note_refusal
        self._under_way: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket") or not scope.get("client"):
            await self._app(scope, receive, send)
            return
        peer, port = scope["client"]
        origin = origin_of(peer, Headers(scope=scope), self._trusted)
        scope["client"] = (origin.address, port)
        if origin.scheme:
            is_socket = scope["type"] == "websocket"
            scope["scheme"] = _SOCKET_SCHEMES[origin.scheme] if is_socket else origin.scheme
        if origin.host:
            MutableHeaders(scope=scope)["host"] = origin.host
        if scope["type"] == "http" and is_within(peer, self._trusted):
            await self._count(source_of(origin.address), scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _count(self, source: str, scope: Scope, receive: Receive, send: Send) -> None:
        if self._under_way[source] >= MAX_UNDER_WAY:
            await TOO_MANY_REQUESTS(scope, receive, send)
            self._note_refusal(source, "429", scope["path"])
            return
        self._under_way[source] += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._under_way[source] -= 1
            if not self._under_way[source]:
                del self._under_way[source]
