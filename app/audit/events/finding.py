"""Finds events by their texts, and by the names of the units that they are about."""

from __future__ import annotations

from collections.abc import Iterable
from urllib.parse import urlencode

from app.audit.events.entry import Event
from app.audit.events.store import Filter, UnitPlace
from app.audit.log import EventLog
from app.errors import StoreError
from app.find.finders import FoundPlace, Search
from app.find.matching import rank, words_of
from app.messages import Language
from app.settings import Settings
from bus.messages import Message

SHOWN = 3
"""Events that are listed; the page of events has the others."""
MAX_SEARCHED = 10_000
"""A key press searches so many entries of the log: in a long one a word that is in none takes seconds."""
LAST = 100
"""Their rank: they come after everything that has the name."""


def units_named(settings: Settings, typed: str) -> tuple[UnitPlace, ...]:
    """The units that people call so."""
    words = words_of(typed)
    if not words:
        return ()
    return tuple(
        (bus.name, unit.id)
        for bus in settings.bus
        for unit in bus.unit
        if rank(words, (unit.name, unit.group)) is not None
    )


class EventFinder:
    def __init__(self, events: EventLog, settings: Settings) -> None:
        self._events = events
        self._settings = settings
        self._names = {(bus.name, unit.id): unit.name for bus in settings.bus for unit in bus.unit}

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        """A way to the page of events with this search, and the newest of them."""
        typed = search.formats.typed_number(search.typed)
        named = units_named(self._settings, search.typed)
        wanted = Filter(search=typed, named=named, folded=True, newest=MAX_SEARCHED)
        try:
            events, _ = await self._events.page(wanted, SHOWN)
        except StoreError:
            events = []
        every = f"/events?{urlencode({'search': search.typed})}"
        more = FoundPlace(Message.of("find_events_with", text=search.typed), every, rank=LAST)
        return [
            *(
                FoundPlace(
                    self._label(event, search.language),
                    f"{every}#event-{event['id']}",
                    search.formats.moment(event["time"]) if event["time"] else "",
                    rank=LAST,
                )
                for event in events
            ),
            more,
        ]

    def _label(self, event: Event, language: Language) -> str:
        """What happened, after the name of the unit that it happened to."""
        what = language.t(event["messages"].get("what", event["what"]))
        name = self._names.get((event["bus"] or "", event["unit"] or 0))
        return f"{name} · {what}" if name else what
