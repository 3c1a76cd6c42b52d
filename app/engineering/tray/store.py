"""The change trays of one bus on disk, so that a restart of the server empties none."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager

import structlog

from app.core.database import Database, StoreConnection
from app.engineering.tray.contents import LASTS_S, MAX_TRAYS, Tray, Trays, key_of, place_of
from app.errors import Problem, StoreError
from app.line.commands.undo import ValuePlace
from app.line.commands.values import parse_scale, scale_text
from app.line.live.bus_live import BusLive
from app.people.audit.log import EventLog
from bus.contract import UnitScale
from bus.instants import Monotonic, monotonic_now, unix_now
from bus.messages import Message

log = structlog.get_logger()
_FORGET_OLD = "DELETE FROM tray WHERE added_at < ?"
_FORGET_MANY = """
DELETE FROM tray WHERE bus = :bus AND sender NOT IN (
    SELECT sender FROM tray WHERE bus = :bus ORDER BY added_at DESC LIMIT :most
)
"""


class TrayStore:
    """Keeps the trays of one bus on disk. A change that is being sent is not kept: whether its unit has taken
    it is in the events."""

    def __init__(self, live: BusLive, trays: Trays, database: Database, events: EventLog) -> None:
        self.trays = trays
        self._live, self._bus = live, live.settings.name
        self._database, self._events = database, events
        self._sending: dict[str, set[ValuePlace]] = {}
        self._storing = asyncio.Lock()

    async def load(self) -> None:
        """Load the trays as the server left them; record an event for changes that are dropped."""
        query = "SELECT sender, added_at, changes, sending FROM tray WHERE bus = ? ORDER BY added_at"
        rows = await self._database.read(lambda store: store.execute(query, (self._bus,)).fetchall())
        for sender, added_at, text, sending in rows:
            age = max(0.0, unix_now() - added_at)
            if age < LASTS_S:
                await self._load(sender, text, Monotonic(monotonic_now() - age), sending)

    async def _load(self, sender: str, text: str, added_at: Monotonic, sending: int) -> None:
        changes, scales, gone = dict[ValuePlace, int](), dict[ValuePlace, UnitScale](), list[ValuePlace]()
        for key, raw, scale in json.loads(text):
            place = place_of(key)
            if place is not None and place.unit in self._live.units:
                changes[place], scales[place] = raw, parse_scale(scale)
            elif place is not None:
                gone.append(place)
        if changes:
            self.trays.put(sender, Tray(changes, scales, added_at))
        account, dropped = sender.rpartition(" ")[0], list[Message]()
        if sending:
            dropped.append(Message.of("tray_interrupted", n=sending, account=account))
        if gone:
            units = ", ".join(map(str, sorted({place.unit for place in gone})))
            dropped.append(Message.of("tray_units_gone", n=len(gone), account=account, units=units))
        for what in dropped:
            await self._events.record(kind="server", bus=self._bus, what=what)
        if dropped:
            await self.save(sender)

    async def save(self, sender: str) -> None:
        """Store the tray of a sender as it is now. One that cannot be stored lasts until the server ends."""
        try:
            await self._write(sender)
        except StoreError as error:
            log.error("change tray not stored", bus=self._bus, error=str(error))

    @asynccontextmanager
    async def sending(self, sender: str, places: Collection[ValuePlace]) -> AsyncIterator[None]:
        """Take changes off the disk while they are sent, until it is known which remain. Raise Problem 503,
        after which nothing may be sent."""
        under_way = self._sending.setdefault(sender, set())
        under_way.update(places)
        try:
            await self._write(sender)
        except StoreError as error:
            under_way.difference_update(places)
            raise Problem(503, "store", error.message) from error
        yield
        under_way.difference_update(places)
        await self.save(sender)

    async def _write(self, sender: str) -> None:
        async with self._storing:
            tray, now = self.trays.tray(sender), unix_now()
            under_way = self._sending.get(sender, set())
            held = {} if tray is None else tray.changes
            scales = {} if tray is None else tray.scales
            kept = [
                (key_of(place), raw, scale_text(scales.get(place, {})))
                for place, raw in held.items()
                if place not in under_way
            ]
            age = 0.0 if tray is None else monotonic_now() - tray.added_at
            row = (self._bus, sender, now - age, json.dumps(kept), len(under_way))

            def write(store: StoreConnection) -> None:
                store.execute("DELETE FROM tray WHERE bus = ? AND sender = ?", row[:2])
                if kept or under_way:
                    store.execute("INSERT INTO tray VALUES (?, ?, ?, ?, ?)", row)
                store.execute(_FORGET_OLD, (now - LASTS_S,))
                store.execute(_FORGET_MANY, {"bus": self._bus, "most": MAX_TRAYS})

            await self._database.write(write)
