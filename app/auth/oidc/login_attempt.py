"""A sign-in that has been sent to the provider: what the browser keeps of it until it is back.

The server keeps nothing, so that any server of the site can take the browser back. Pure.
"""

from __future__ import annotations

import hmac
from base64 import urlsafe_b64decode, urlsafe_b64encode
from hashlib import sha256
from typing import Annotated

import msgspec

from app.auth import rules

MAX_AGE_S = 600
"""How long a person may take at the provider."""
MAX_NEXT = 1000
MAX_COOKIE_BYTES = 3000
_Secret = Annotated[str, msgspec.Meta(min_length=rules.SECRET_LENGTH, max_length=rules.SECRET_LENGTH)]


class LoginAttempt(msgspec.Struct, frozen=True, array_like=True):
    """``state`` ties the way back to this browser (RFC 6749, 10.12), ``nonce`` the ID token to this attempt,
    and ``verifier`` the code to this client (RFC 7636). ``next``: the page that the person wanted."""

    state: _Secret
    nonce: _Secret
    verifier: _Secret
    next: Annotated[str, msgspec.Meta(max_length=MAX_NEXT)]

    @property
    def challenge(self) -> str:
        """The challenge of the verifier, by S256."""
        return _text(sha256(self.verifier.encode()).digest())

    def has_state(self, state: str) -> bool:
        return hmac.compare_digest(state.encode(), self.state.encode())

    def to_cookie(self) -> str:
        return _text(msgspec.json.encode(self))


def new_attempt(next_page: str) -> LoginAttempt:
    """A new one. ``next_page``: a page of this server, else the first one."""
    is_kept = rules.is_own_path(next_page) and len(next_page) <= MAX_NEXT
    return LoginAttempt(
        rules.new_secret(), rules.new_secret(), rules.new_secret(), next_page if is_kept else "/"
    )


def attempt_of(cookie: str) -> LoginAttempt | None:
    """The attempt of a cookie; None for any other text."""
    if not 0 < len(cookie) <= MAX_COOKIE_BYTES or not cookie.isascii():
        return None
    try:
        return msgspec.json.decode(urlsafe_b64decode(cookie + "=" * (-len(cookie) % 4)), type=LoginAttempt)
    except (msgspec.MsgspecError, ValueError):
        return None


def _text(content: bytes) -> str:
    """Base64 for addresses, without padding (RFC 7636, A)."""
    return urlsafe_b64encode(content).rstrip(b"=").decode()
