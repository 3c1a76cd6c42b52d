"""Control of a bus as the head of every page shows it: who holds it until when, and who requests it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from app.core.web.admission.access import account_shown
from bus.instants import UnixTime
from bus.messages import Message


@dataclass(frozen=True, slots=True)
class BusControl:
    """``holder``: an account, empty where control is free. ``since``, ``lapses_at`` and ``request_until``:
    Unix time in seconds. ``request``: the state of the request of ``requester``, empty where none is."""

    bus: str
    holder: str = ""
    since: UnixTime = UnixTime(0.0)
    lapses_at: UnixTime = UnixTime(0.0)
    requester: str = ""
    request: Literal["", "pending", "declined", "lapsed"] = ""
    request_until: UnixTime = UnixTime(0.0)

    def requested(
        self, by: str, state: Literal["pending", "declined", "lapsed"], until: UnixTime
    ) -> BusControl:
        """The same with a request."""
        return replace(self, requester=by, request=state, request_until=until)

    @property
    def holder_shown(self) -> str | Message:
        """The holder in the reader's language where it is a program."""
        return account_shown(self.holder)

    @property
    def requester_shown(self) -> str | Message:
        """The same of the one who requests control."""
        return account_shown(self.requester)

    @property
    def key(self) -> str:
        """Another text whenever a page shows something else; time left is no part of it."""
        return "\n".join((self.bus, self.holder, f"{self.since:.3f}", self.requester, self.request))


@dataclass(frozen=True, slots=True)
class HeadControl:
    """Gives control of each bus, in the order of the configuration."""

    of_buses: Callable[[], Sequence[BusControl]]
