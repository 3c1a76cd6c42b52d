"""The drift of units from their golden sets, and who caused it: a user, or a person at the panel."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from app.audit.log import Event, EventLog
from app.audit.store import Filter
from app.live.screen.fields import Translator
from app.live.screen.sources import Drifted, UnitSubscriber
from app.live.state.bus_live import Audience, BusLive
from app.sets.background import Background
from app.sets.compare import Compared, drift
from app.sets.model import UnitRows
from app.sets.reading import known_rows
from app.sets.store import SetStore
from app.web.formats import Formats
from bus.catalogue.parameters import PARAMETERS
from bus.contract import ParameterValue, Update
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class DriftedParameter:
    """One row that differs from the golden set. ``change``: the command that caused it; None: no command
    did: it was changed at the panel. ``traced`` False: the events have not been searched yet."""

    row: Compared
    change: Event | None = None
    traced: bool = False

    @property
    def key(self) -> str:
        """A text that changes with the displayed drift."""
        left, right = (None if side is None else side.raw for side in (self.row.left, self.row.right))
        return f"{self.row.number}={left}>{right}@{self.change['id'] if self.change else ''}"

    def same(self, other: DriftedParameter) -> bool:
        """Return whether both state the same difference, regardless of its cause."""
        mine, theirs = self.row.right, other.row.right
        return self.row.number == other.row.number and (mine and mine.raw) == (theirs and theirs.raw)


class BusDrift:
    """Compares every unit of one bus that has a golden set with it as its parameters are read."""

    def __init__(self, live: BusLive, store: SetStore, events: EventLog) -> None:
        self._live = live
        self._bus = live.settings.name
        self._store = store
        self._events = events
        self._golden: dict[int, UnitRows] = {}
        self._found: dict[int, dict[int, DriftedParameter]] = {}
        self.background = Background()
        self._subscribers: list[UnitSubscriber] = []
        live.subscribe(Audience.DRIFT, self._see)

    def on_change(self, subscriber: UnitSubscriber) -> None:
        """Call ``subscriber`` when the departures of a unit have changed."""
        self._subscribers.append(subscriber)

    async def load(self) -> None:
        """Read which sets are golden; once at start, and after a mark has moved."""
        self._golden = await self._store.golden(self._bus)
        self._found = {}
        for unit in self.marked():
            self._look(unit, PARAMETERS)

    def marked(self) -> list[int]:
        """The configured units that have a golden set."""
        return [unit for unit in self._golden if unit in self._live.units]

    def has_golden(self, unit: int) -> bool:
        """Whether a set of this unit is its golden set."""
        return unit in self._golden

    def of(self, unit: int) -> list[DriftedParameter]:
        """Rows in which a unit, as last read, departs from its golden set."""
        return list(self._found.get(unit, {}).values())

    async def traced(self, unit: int) -> list[DriftedParameter]:
        """The drift, after the events have been searched for every row."""
        await self._trace(unit, self.of(unit))
        return self.of(unit)

    def unread(self, unit: int) -> int:
        """How many parameters have not been read from the unit since the server started."""
        known = self._live.units[unit].parameters
        return sum(number not in known for number in PARAMETERS)

    def summary(self, unit: int, translator: Translator, now: UnixTime) -> Drifted:
        """The same for the line, and what the list of them on the unit's page depends on."""
        if unit not in self._golden:
            return Drifted()
        found = self.of(unit)
        rows = ",".join(one.key for one in found)
        return Drifted(_summary_text(found, translator, now) if found else "", f"{self.unread(unit)}:{rows}")

    def _see(self, updates: Sequence[Update]) -> None:
        """Parameters were read: compare now, instead of forty rows at every reading."""
        read: dict[int, set[int]] = {}
        for update in updates:
            if isinstance(update, ParameterValue) and update.unit in self._golden:
                read.setdefault(update.unit, set()).add(update.number)
        for unit, numbers in read.items():
            self._look(unit, numbers)

    def _look(self, unit: int, numbers: Iterable[int]) -> None:
        """Compare again; ``numbers`` were read: their change is searched for again."""
        before, named = self._found.get(unit, {}), frozenset(numbers)
        rows = drift(self._golden[unit], known_rows(self._live.units[unit]))
        found = {row.number: _known_before(DriftedParameter(row), before) for row in rows}
        self._found[unit] = found
        untraced = [one for one in found.values() if not one.traced or one.row.number in named]
        if untraced:
            self.background.begin(self._trace(unit, untraced), f"who changed unit {unit} of {self._bus}")

    async def _trace(self, unit: int, departures: list[DriftedParameter]) -> None:
        before = self.of(unit)
        for one in departures:
            change = await who_changed(self._events, self._bus, unit, one.row)
            present = self._found.get(unit, {})
            if one.row.number in present and one.same(present[one.row.number]):
                present[one.row.number] = DriftedParameter(one.row, change, traced=True)
        if self.of(unit) != before:
            for subscriber in self._subscribers:
                subscriber(unit)


def _known_before(departure: DriftedParameter, before: dict[int, DriftedParameter]) -> DriftedParameter:
    """A change found for the same value is kept until the events have been searched again."""
    earlier = before.get(departure.row.number)
    if earlier is None or not departure.same(earlier):
        return departure
    return DriftedParameter(departure.row, earlier.change, earlier.traced)


def _summary_text(found: list[DriftedParameter], translator: Translator, now: UnixTime) -> str:
    number, n, tn = found[0].row.number, len(found), translator.tn
    if not all(one.traced for one in found):
        return tn(
            "#{number} differs from the golden set", "{n} values differ from the golden set", n, number=number
        )
    people = _latest_of_each(found)
    at_panel = sum(one.change is None for one in found)
    if not people:
        return tn(
            "#{number} differs from the golden set, changed at the panel",
            "{n} values differ from the golden set, changed at the panel",
            n,
            number=number,
        )
    if len(people) == 1 and not at_panel:
        ((change, _),) = people
        return tn(
            "#{number} differs from the golden set: changed by {who} {when}",
            "{n} values differ from the golden set: changed by {who} {when}",
            n,
            number=number,
            **_by(change, translator.formats, now),
        )
    formats = translator.formats
    parts = [
        translator.t("{m} changed by {who} {when}", m=rows, **_by(change, formats, now))
        for change, rows in people
    ]
    if at_panel:
        parts.append(translator.t("{m} changed at the panel", m=at_panel))
    return translator.t("{n} values differ from the golden set: {parts}", n=n, parts=", ".join(parts))


def _latest_of_each(found: list[DriftedParameter]) -> list[tuple[Event, int]]:
    """The last change of every person, newest first, and how many rows are theirs."""
    by_person: dict[str, list[Event]] = {}
    for one in found:
        if one.change is not None:
            by_person.setdefault(one.change["who"], []).append(one.change)
    latest = [
        (max(events, key=lambda event: float(event["time"])), len(events)) for events in by_person.values()
    ]
    return sorted(latest, key=lambda each: -float(each[0]["time"]))


def _by(change: Event, formats: Formats, now: UnixTime) -> dict[str, str]:
    return {"who": change["who"], "when": formats.since(change["time"], now)}


_ACTED = ("verified", "acknowledged", "unverified", None)
"""Outcomes after which the unit may have taken the value; None: it was read before the outcome was stored."""
_LOOK_BACK = 20
"""Refused commands are among them: so many newest events of a parameter are examined."""


async def who_changed(events: EventLog, bus: str, unit: int, row: Compared) -> Event | None:
    """The event of our write, later than the reading of the left side (the golden set), that left the
    right side as it is; None when it was changed at the panel."""
    since = None if row.left is None else row.left.read_at
    wanted = Filter(
        kind="command", bus=bus, unit=unit, since=since, code="event_write_parameter", number=row.number
    )
    found, _ = await events.page(wanted, _LOOK_BACK)
    last = next((event for event in found if event["outcome"] in _ACTED), None)
    if row.right is None:
        return None
    if last is None:
        return await _older(events, bus, unit, row)
    # A secret is in no event: only its last write can be named.
    known = PARAMETERS[row.number].secret or last["new_raw"] == row.right.raw
    return last if known else None


async def _older(events: EventLog, bus: str, unit: int, row: Compared) -> Event | None:
    """A command of a version that stored no parameter number: the one from the left value to the right."""
    if row.left is None or row.right is None or row.left.raw is None or row.right.raw is None:
        return None
    since, old, new = row.left.read_at, row.left.raw, row.right.raw
    wanted = Filter(kind="command", bus=bus, unit=unit, since=since, old_raw=old, new_raw=new)
    found, _ = await events.page(wanted, _LOOK_BACK)
    return next((event for event in found if not event["messages"] and event["outcome"] in _ACTED), None)
