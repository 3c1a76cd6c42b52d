"""What a person does to a thing other than a unit: an alarm, a shift, a set, a recipe, an account."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypedDict

from fastapi import Depends
from starlette.requests import HTTPConnection

from app.audit.act_limit import ActLimit
from app.audit.events.kinds import EventKind
from app.web.admission.access import Person, Requires, Role, refuse_without
from app.web.services import service_of
from bus.instants import monotonic_now
from bus.messages import TEXTS, Message, ParamValue

READS = frozenset({"GET", "HEAD"})


class _Performs(Requires):
    """A dependency that counts what it lets in, but for pages about it, among the acts of the account."""

    async def resolve(self, connection: HTTPConnection) -> Person:
        person = await super().resolve(connection)
        if connection.scope["method"] not in READS:
            service_of(connection, ActLimit).count(person.account, monotonic_now())
        return person


class Performed(TypedDict):
    """What `EventLog.record` takes of an act."""

    kind: EventKind
    who: str | Message
    origin: str | Message
    what: Message


@dataclass(frozen=True, slots=True)
class Act:
    """``name`` is the operation of the API and the word of ``may("…")`` in templates. ``role`` is checked by
    the route before it reads the body, and again by the service that does it. ``event`` is the code of the
    text in the audit log, of kind ``kind``. Raises ValueError for one without a text."""

    name: str
    role: Role
    kind: EventKind
    event: str
    counted: bool = field(default=True, kw_only=True)
    """Whether an account does it only so often; not where something else bounds it, as alarms do their
    acknowledgement, which nothing may delay."""

    def __post_init__(self) -> None:
        if self.event not in TEXTS:
            raise ValueError(f"act {self.name} has no text: {self.event}")

    @property
    def permitted(self) -> Any:
        """A dependency of a route: ``Annotated[Person, RETIRE.permitted]``."""
        return Depends((_Performs if self.counted else Requires)(self.role, self.name))

    def check(self, person: Person) -> None:
        """Raises Problem 403 ``forbidden`` for a person whose role does not include that of the act."""
        refuse_without(self.role, person)

    def by(self, person: Person, **params: ParamValue) -> Performed:
        """What the audit log records of it: ``events.record(**RETIRE.by(person, name=name), bus=bus)``."""
        what = Message.of(self.event, **params)
        return {"kind": self.kind, **person.author, "what": what}
