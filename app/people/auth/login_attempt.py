"""An attempt to log in by a company account, which only its browser keeps, and the reasons for a refusal."""

from __future__ import annotations

import hmac
from base64 import urlsafe_b64decode, urlsafe_b64encode
from typing import Annotated, Literal, get_args

import msgspec

from app.people.auth import rules
from bus.messages import Message

MAX_AGE_S = 600
"""The seconds that a person may take at the provider."""
MAX_NEXT = 1000
MAX_COOKIE_BYTES = 3000
_Secret = Annotated[str, msgspec.Meta(min_length=rules.SECRET_LENGTH, max_length=rules.SECRET_LENGTH)]

NotAdmittedReason = Literal[
    "away",
    "busy",
    "canceled",
    "disabled",
    "expired",
    "groups",
    "name",
    "name_taken",
    "provider",
    "token",
]
"""Codes of the reasons for which a login is refused, as they appear in the address of the login page."""
COUNTED: frozenset[NotAdmittedReason] = frozenset({"disabled", "groups", "name", "name_taken", "token"})
"""Reasons for which a refused login is recorded as an event in the audit log, as a wrong password is."""


class NotAdmittedError(Exception):
    """Raised when a company account is not admitted. ``reason``: shown to the person; ``detail``: for the log
    and the event; ``name``: that of the account, once it is known."""

    def __init__(self, reason: NotAdmittedReason, detail: str = "", name: str = "") -> None:
        super().__init__(reason)
        self.reason: NotAdmittedReason = reason
        self.detail = detail
        self.name = name


def refusal_shown(reason: str) -> Message | None:
    """Return the text for a reason in an address; None for an unknown one."""
    return Message(f"company_account_{reason}") if reason in get_args(NotAdmittedReason) else None


class LoginAttempt(msgspec.Struct, frozen=True, array_like=True):
    """A login by a company account that is under way. ``state`` ties the way back to this browser (RFC 6749,
    10.12), ``nonce`` the ID token to this attempt, and ``verifier`` the code to this client (RFC 7636).
    ``next``: the page that the person wanted."""

    state: _Secret
    nonce: _Secret
    verifier: _Secret
    next: Annotated[str, msgspec.Meta(max_length=MAX_NEXT)]

    def has_state(self, state: str) -> bool:
        return hmac.compare_digest(state.encode(), self.state.encode())

    def to_cookie(self) -> str:
        return urlsafe_b64encode(msgspec.json.encode(self)).rstrip(b"=").decode()


def new_attempt(next_page: str) -> LoginAttempt:
    """Make an attempt that leads to ``next_page`` if that is a page of this server, else to the first."""
    is_kept = rules.is_own_path(next_page) and len(next_page) <= MAX_NEXT
    state, nonce, verifier = (rules.new_secret() for _ in range(3))
    return LoginAttempt(state, nonce, verifier, next_page if is_kept else "/")


def attempt_of(cookie: str) -> LoginAttempt | None:
    """Return the attempt of a cookie; None for any other text."""
    if not 0 < len(cookie) <= MAX_COOKIE_BYTES or not cookie.isascii():
        return None
    try:
        return msgspec.json.decode(urlsafe_b64decode(cookie + "=" * (-len(cookie) % 4)), type=LoginAttempt)
    except (msgspec.MsgspecError, ValueError):
        return None


def printable(text: str) -> str:
    """Return the start of a provider's word in a form that a log can hold."""
    return "".join(each for each in text[:80] if each.isascii() and each.isprintable())
