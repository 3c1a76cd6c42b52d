"""An admin restarts the server, with the configuration that its file has by now."""

from __future__ import annotations

import asyncio

from app.core.web.admission.access import Person
from app.errors import Problem
from app.people.audit.log import EventLog
from app.system.configuration.acts import RESTART
from app.system.configuration.service import ConfigurationFile
from bus.messages import Message

DELAY_S = 1.0
"""Within which a browser loads the page that it is sent to, which then follows the restart."""


class Restart:
    """Restarts the server where what runs it offers that: a demonstration does not, nor does a server that
    was started with rights or at a port that it would not get again."""

    def __init__(self, file: ConfigurationFile, events: EventLog) -> None:
        self._file = file
        self._events = events
        self._requested: asyncio.Event | None = None

    @property
    def is_offered(self) -> bool:
        return self._requested is not None

    def offer(self) -> asyncio.Event:
        """From now on a person may restart the server: what is returned is set a moment after that."""
        self._requested = asyncio.Event()
        return self._requested

    async def request(self, person: Person, digest: str, reason: str) -> None:
        """Restart within a second. Raises Problem 403, and 409 where the file is another one by now, or one
        with which the server would not start, or where it cannot restart."""
        RESTART.check(person)
        if self._requested is None:
            raise Problem(409, "not_in_state", Message("restart_not_offered"))
        present = await self._file.present()
        self._file.refuse_superseded(present, digest)
        if present.faults:
            faults = Message.of("several", messages=list(present.faults))
            raise Problem(409, "not_in_state", Message.of("restart_refused", faults=faults))
        await self._events.record(**RESTART.by(person, reason=reason or "-"))
        asyncio.get_running_loop().call_later(DELAY_S, self._requested.set)
