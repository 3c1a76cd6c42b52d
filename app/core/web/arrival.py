"""The time at which a request was made, as far as it can be known, and how long its command may wait after
that.

Three clocks give the time, and the earliest is believed: the server, which stamps each request with the
moment at which its first byte arrived (app/core/server/gate.py), a stall or a start of the server included; a
program, in the header ``Lineside-Sent-At``; a page of ours, in the header ``Lineside-Clicked-At`` or, if the
browser sends the form itself, in the query ``clicked_at`` (static/js/review.js).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime

from starlette.requests import HTTPConnection

from app.core.server.connections import ARRIVED_AT, BEGUN_AT
from app.errors import Problem
from bus.instants import Monotonic, UnixTime, monotonic_now, unix_now
from bus.messages import Message, number

SENT_AT = "lineside-sent-at"
_CLICKED_AT = ("lineside-clicked-at", "lineside-asked-at")
_CLICKED_AT_IN_QUERY = ("clicked_at", "asked_at")
"""The second name of each is for a page that was opened before version 0.2 and is still open."""
MAX_AHEAD_S = 5.0
"""The most seconds by which a program's clock may be ahead of the server's."""
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})


def made_at(connection: HTTPConnection) -> Monotonic:
    """Return when this request was made; for one that only reads, when it arrived.

    Raise Problem 422 if the ``Lineside-Sent-At`` of a write is impossible.
    """
    now = monotonic_now()
    arrived = Monotonic(connection.scope.get("state", {}).get(ARRIVED_AT, now))
    if _only_reads(connection):
        return arrived
    sent = (_program_sent_at(connection), _page_requested_at(connection))
    age_s = max((unix_now() - at for at in sent if at is not None), default=0.0)
    return min(arrived, now - age_s)


def refuse_late(connection: HTTPConnection) -> None:
    """Raise Problem 503 for a write that was too long on its way; the time for a long body does not count.
    Reading is never late."""
    if not _only_reads(connection):
        begun_at = connection.scope.get("state", {}).get(BEGUN_AT)
        Deadline(made_at(connection), DEFAULT_TIMEOUT_S).refuse_passed(begun_at)


def _only_reads(connection: HTTPConnection) -> bool:
    return connection.scope.get("method", "GET") in SAFE_METHODS


def _program_sent_at(connection: HTTPConnection) -> UnixTime | None:
    """Return when a program states that it sent the request, Unix time in seconds. Raise Problem 422."""
    given = connection.headers.getlist(SENT_AT)
    if not given:
        return None
    at = _moment(given[0]) if len(given) == 1 else None
    if at is None:
        raise Problem(422, "invalid", Message("sent_at_malformed"))
    ahead_s = at - unix_now()
    if ahead_s > MAX_AHEAD_S:
        raise Problem(422, "invalid", Message.of("sent_at_in_future", ahead=number(f"{ahead_s:.1f}")))
    return at


def _moment(text: str) -> UnixTime | None:
    try:
        at = datetime.fromisoformat(text.strip())
        return UnixTime(at.timestamp()) if at.tzinfo is not None else None
    except (ValueError, OverflowError):
        return None


def _page_requested_at(connection: HTTPConnection) -> UnixTime | None:
    """Return when the person clicked, Unix time in seconds by the server's clock, which the page knows; None
    if the page does not state it."""
    headers, query = connection.headers, connection.query_params
    given = [headers.get(name) for name in _CLICKED_AT] + [query.get(name) for name in _CLICKED_AT_IN_QUERY]
    value = next((each for each in given if each), "")
    with suppress(ValueError, OverflowError):
        at = UnixTime(float(value))
        return at if at == at else None
    return None


DEFAULT_TIMEOUT_S = 2.0
"""The seconds for which a write may still be sent after it was made, by default."""


@dataclass(frozen=True, slots=True)
class Deadline:
    """The last moment at which a command may be sent: ``timeout_s`` seconds after it was made."""

    made_at: Monotonic
    timeout_s: float

    @classmethod
    def within(cls, timeout_s: float) -> Deadline:
        """Return the deadline of a command that is made now."""
        return cls(monotonic_now(), timeout_s)

    @property
    def left_s(self) -> float:
        """The seconds until the deadline; negative once it has passed."""
        return self.made_at + self.timeout_s - monotonic_now()

    def refuse_passed(self, now: Monotonic | None = None) -> None:
        """Raise Problem 503 ``not_sent`` once the deadline has passed, or had by ``now``."""
        left_s = self.left_s if now is None else self.made_at + self.timeout_s - now
        if left_s > 0:
            return
        age, allowed = number(f"{self.timeout_s - left_s:.1f}"), number(f"{self.timeout_s:.3g}")
        reason = Message.of("came_too_late", age=age, allowed=allowed)
        raise Problem(503, "not_sent", reason, outcome="not_sent")
