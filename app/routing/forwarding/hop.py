"""What a server states of a request that it passes on, and the proof that a server of the site states it.
Pure.

A hop carries what the home cannot see: when the request arrived, from where, and under which name. The
proof is an HMAC with a secret that is in the store alone. It covers the method and the target, so that a
hop proves nothing for another request.
"""

from __future__ import annotations

import hmac
from base64 import urlsafe_b64decode, urlsafe_b64encode
from binascii import Error as Base64Error
from typing import Annotated

import msgspec

from bus.instants import UnixTime

HEADER = "lineside-hop"
SECRET_BYTES = 32
MAX_HOP_BYTES = 1024
MAX_AGE_S = 60.0
"""A hop is no proof after so long: the longest body takes less."""
_HopText = Annotated[str, msgspec.Meta(max_length=300)]


class Hop(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``sender``: the id of the server that passes the request on. ``arrived_at`` and ``sent_at``: times of
    the store. ``client``: the address of the person; ``scheme`` and ``host``: how the person reached the
    sender."""

    sender: _HopText
    arrived_at: float
    sent_at: float
    client: _HopText
    scheme: _HopText
    host: _HopText


class ForgedHopError(Exception):
    """A hop that no server of the site has made, or made for another request or long ago."""


def sealed(hop: Hop, secret: bytes, method: str, target: bytes) -> str:
    """The value of the header for a request; ``target``: its path and query as sent."""
    content = msgspec.json.encode(hop)
    return f"{urlsafe_b64encode(content).decode()}.{_proof(content, secret, method, target)}"


def opened(value: str, secret: bytes, method: str, target: bytes, now: UnixTime) -> Hop:
    """The hop of a header. ``now``: a time of the store. Raises ForgedHopError."""
    encoded, _, proof = value.partition(".")
    if len(value) > MAX_HOP_BYTES or not value.isascii():
        raise ForgedHopError
    try:
        content = urlsafe_b64decode(encoded)
    except (Base64Error, ValueError):
        raise ForgedHopError from None
    if not hmac.compare_digest(proof, _proof(content, secret, method, target)):
        raise ForgedHopError
    try:
        hop = msgspec.json.decode(content, type=Hop)
    except msgspec.MsgspecError:
        raise ForgedHopError from None
    if abs(float(now) - hop.sent_at) > MAX_AGE_S:
        raise ForgedHopError
    return hop


def _proof(content: bytes, secret: bytes, method: str, target: bytes) -> str:
    # Each part but the last has its length before it: none can pass for a part of another.
    parts = (method.encode(), target)
    text = b"".join(len(part).to_bytes(4, "big") + part for part in parts) + content
    return hmac.new(secret, text, "sha256").hexdigest()
