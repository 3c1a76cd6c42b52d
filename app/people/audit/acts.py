"""The acts of people on things other than units: an alarm, a shift, a set, a recipe, an account. Each is an
event in a log that is kept for good, so the acts of an account are limited in rate."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, TypedDict

from fastapi import Depends
from starlette.requests import HTTPConnection

from app.core.web.access import Person, Requires, Role, refuse_without
from app.core.web.routes import RateLimit
from app.core.web.services import service_of
from app.errors import Problem
from app.people.audit.entry import EventKind
from bus.instants import Monotonic, monotonic_now
from bus.messages import TEXTS, Message, ParamValue
from bus.pacing import Bucket

MAX_ACTS, ACTS_PER_S = 600, 5.0
"""The acts of an account at once, and per second: more than a program needs to acknowledge a flood of
alarms."""
READS = frozenset({"GET", "HEAD"})


@dataclass(eq=False)
class ActLimit:
    """The budget of acts of each account. Commands do not count, because the wire bounds them."""

    _performed: defaultdict[str, Bucket] = field(
        default_factory=lambda: defaultdict(lambda: Bucket(ACTS_PER_S, MAX_ACTS)), init=False
    )

    def count(self, account: str, now: Monotonic) -> None:
        """Count one more act. Raise Problem 429 with the time to wait."""
        performed = self._performed[account]
        if performed.take(now):
            return
        seconds = math.ceil(performed.wait_s(now))
        problem = Problem(429, "too_many", Message.of("acts_too_many", n=seconds))
        problem.headers.update(RateLimit.of_bucket(performed, now).headers)
        raise problem.with_headers(Retry_After=str(seconds))


class _Performs(Requires):
    """A dependency that counts the requests it admits as acts of the account, except those for pages."""

    async def grant(self, connection: HTTPConnection) -> Person:
        person = await super().grant(connection)
        if connection.scope["method"] not in READS:
            service_of(connection, ActLimit).count(person.account, monotonic_now())
        return person


class Performed(TypedDict):
    """The arguments of `EventLog.record` for an act."""

    kind: EventKind
    who: str | Message
    origin: str | Message
    what: Message


@dataclass(frozen=True, slots=True)
class Act:
    """An act of people. ``name`` is the operation of the API and the word of ``may("…")`` in templates.
    ``role`` is checked by the route before it reads the body, and again by the service. ``event`` is the code
    of the text in the audit log, of kind ``kind``. Raises ValueError if that code has no text."""

    name: str
    role: Role
    kind: EventKind
    event: str
    counted: bool = field(default=True, kw_only=True)
    """Whether the act counts for `ActLimit`. An acknowledgement does not: the number of alarms bounds it, and
    nothing may delay it."""

    def __post_init__(self) -> None:
        if self.event not in TEXTS:
            raise ValueError(f"act {self.name} has no text: {self.event}")

    @property
    def permitted(self) -> Any:
        """The dependency of a route: ``Annotated[Person, RETIRE.permitted]``."""
        return Depends((_Performs if self.counted else Requires)(self.role, self.name))

    def check(self, person: Person) -> None:
        """Raise Problem 403 ``forbidden`` for a person whose role does not include that of the act."""
        refuse_without(self.role, person)

    def by(self, person: Person, **params: ParamValue) -> Performed:
        """Return the arguments to record the act: ``events.record(**RETIRE.by(person, name=name),
        bus=bus)``."""
        what = Message.of(self.event, **params)
        return {"kind": self.kind, **person.author, "what": what}
