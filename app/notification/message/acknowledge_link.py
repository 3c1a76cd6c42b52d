"""Links that lead from a notification to the acknowledgement of its alarm. Pure: the time is passed in."""

from __future__ import annotations

import hmac
from urllib.parse import urlencode

from app.errors import Problem
from bus.instants import UnixTime
from bus.messages import Message

PATH = "/notifications/acknowledge"
VALID_S = 7 * 86_400


def acknowledge_link(base: str, key: bytes, alarm_id: str, now: UnixTime) -> str:
    """A link for one occurrence. It signs no one in, and opening it changes nothing."""
    until = int(float(now)) + VALID_S
    query = {"alarm": alarm_id, "until": until, "signature": _signature(key, alarm_id, until)}
    return f"{base.rstrip('/')}{PATH}?{urlencode(query)}"


def check_link(key: bytes, alarm_id: str, until: int, signature: str, now: UnixTime) -> None:
    """Raises Problem 403 for a link that this dashboard did not make, or that has expired."""
    if not hmac.compare_digest(_signature(key, alarm_id, until).encode(), signature.encode()):
        raise Problem(403, "forbidden", Message("notify_link_invalid"))
    if float(now) > until:
        raise Problem(403, "forbidden", Message("notify_link_expired"))


def _signature(key: bytes, alarm_id: str, until: int) -> str:
    return hmac.new(key, f"{until} {alarm_id}".encode(), "sha256").hexdigest()
