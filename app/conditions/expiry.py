"""When it is time to replace what expires. Pure."""

from __future__ import annotations

from bus.instants import UnixTime

DAY_S = 86_400.0
CERTIFICATE_S = 30 * DAY_S
TOKEN_S = 14 * DAY_S
TOKEN_SHARE = 0.1
"""Of its life: a token for a day is no alarm from the start."""
IN_USE_S = 30 * DAY_S
"""A token that no program has used for so long is not missed."""


def certificate_expires(ends_at: UnixTime, now: UnixTime) -> bool:
    """Whether a certificate ends soon, or has ended."""
    return ends_at - now < CERTIFICATE_S


def token_expires(
    created_at: UnixTime, expires_at: UnixTime | None, used_at: UnixTime | None, now: UnixTime
) -> bool:
    """Whether a token that is in use ends soon, or has ended."""
    if expires_at is None or used_at is None or now - used_at > IN_USE_S:
        return False
    return expires_at - now < min(TOKEN_S, TOKEN_SHARE * (expires_at - created_at))
