"""Network addresses as limits and logs see them."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

Address = IPv4Address | IPv6Address
Network = IPv4Network | IPv6Network

SUBNET_BITS = 64
"""Prefix of an IPv6 subnet, which one subscriber or one machine has at least (RFC 6177, 2)."""
MAX_REMEMBERED = 1024


def parse_address(text: str) -> Address | None:
    """Parse an address, an IPv4 one also where a dual-stack socket writes it as ``::ffff:10.0.0.5``."""
    try:
        address = ip_address(text)
    except ValueError:
        return None
    return getattr(address, "ipv4_mapped", None) or address


def canonical(text: str) -> str:
    """Return an address in its one usual form; anything else as it is."""
    return str(parse_address(text) or text)


@lru_cache(maxsize=MAX_REMEMBERED)
def source_of(text: str) -> str:
    """Return the key by which a client is counted: an IPv4 address, the /64 of an IPv6 one, else
    ``address``."""
    address = parse_address(text)
    if isinstance(address, IPv6Address):
        return str(ip_network((int(address) >> SUBNET_BITS << SUBNET_BITS, SUBNET_BITS)))
    return str(address or text)


def is_within(text: str, networks: Collection[Network]) -> bool:
    """Whether the address belongs to one of the networks."""
    address = parse_address(text)
    return address is not None and any(address in network for network in networks)
