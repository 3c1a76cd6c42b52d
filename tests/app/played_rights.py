"""Rights that a test grants and withdraws."""

from __future__ import annotations

from app.core.web.access import AccountSubscriber, Person
from app.errors import Problem
from bus.messages import Message


class PlayedRights:
    """Permits every request, except of those in ``withdrawn``: the reason by name."""

    def __init__(self) -> None:
        self.withdrawn: dict[str, str] = {}

    async def check(self, person: Person) -> None:
        """As the real ones."""
        reason = self.withdrawn.get(person.name)
        if reason is not None:
            raise Problem(
                403, "rights_withdrawn", Message.of("system_error", error=reason), outcome="rights_withdrawn"
            )

    def on_withdrawn(self, _subscriber: AccountSubscriber) -> None:
        """Do nothing: subscribers are not notified of what a test withdraws."""
