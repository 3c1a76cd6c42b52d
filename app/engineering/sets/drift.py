"""The drift of units from their golden sets, and its cause: a user, or a person at the keypad."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from app.core.lifespan import Background
from app.core.web.formats import Formats
from app.engineering.sets.model import ParameterDifference, ParameterRow, UnitRows, differences, known_rows
from app.engineering.sets.store import SetStore
from app.line.commands.effects import OPERATING_VALUES
from app.line.live.bus_live import Audience, BusLive
from app.line.live.fields import Translator
from app.line.live.sources import Drifted
from app.people.audit.log import Event, EventLog, Filter
from bus.catalogue.parameters import PARAMETERS
from bus.contract import ParameterValue, Update
from bus.instants import UnixTime
from bus.messages import Message, ParamValue, listed


@dataclass(frozen=True, slots=True)
class DriftedParameter:
    """A parameter that differs from the golden set: ``before`` in the set, ``after`` as last read.

    ``change`` is the command that caused the difference, None for a change at the keypad; it is valid only
    once the events have been searched (``traced``).
    """

    row: ParameterDifference
    before: ParameterRow
    after: ParameterRow
    change: Event | None = None
    traced: bool = False

    @property
    def key(self) -> str:
        """A text that changes whenever the displayed difference changes."""
        return (
            f"{self.row.number}={self.before.raw}>{self.after.raw}@{self.change['id'] if self.change else ''}"
        )

    def is_of_same_value(self, other: DriftedParameter) -> bool:
        """Return whether both are the same difference, whatever caused them."""
        return (self.row.number, self.after.raw) == (other.row.number, other.after.raw)


class BusDrift:
    """The comparison of the units of one bus with their golden sets as values arrive."""

    def __init__(self, live: BusLive, store: SetStore, events: EventLog) -> None:
        self._live = live
        self._bus = live.settings.name
        self._store = store
        self._events = events
        self._golden: dict[int, UnitRows] = {}
        self._found: dict[int, dict[int, DriftedParameter]] = {}
        self.background = Background()
        self._subscribers: list[Callable[[int], None]] = []
        live.subscribe(Audience.DRIFT, self._see)

    def on_change(self, subscriber: Callable[[int], None]) -> None:
        """Call ``subscriber`` with each unit whose drift has changed."""
        self._subscribers.append(subscriber)

    async def load(self) -> None:
        """Load the golden sets: at the start and after a set was marked golden."""
        self._golden = await self._store.golden(self._bus)
        self._found = {}
        for unit in self.marked():
            self._compare(unit, PARAMETERS)

    def marked(self) -> list[int]:
        """Return the configured units that have a golden set."""
        return [unit for unit in self._golden if unit in self._live.units]

    def has_golden(self, unit: int) -> bool:
        """Return whether the unit has a golden set."""
        return unit in self._golden

    def differing(self, unit: int) -> list[DriftedParameter]:
        """Return the parameters that, as last read, differ from the unit's golden set."""
        return list(self._found.get(unit, {}).values())

    def is_drifted(self, unit: int) -> bool | None:
        """Return whether the unit differs from its golden set; None while values of it have not been read."""
        if self.differing(unit) or unit not in self._golden:
            return bool(self.differing(unit))
        known = self._live.units[unit].parameters
        return False if self._golden[unit].rows.keys() - OPERATING_VALUES <= known.keys() else None

    def golden_values(self, unit: int) -> dict[int, Message]:
        """Return the golden value of each parameter that differs from it, by number, without its measure."""
        return {one.row.number: _without_measure(one.row.left) for one in self.differing(unit)}

    async def traced(self, unit: int) -> list[DriftedParameter]:
        """Return the drift of a unit after searching the events for each change."""
        await self._trace(unit, self.differing(unit))
        return self.differing(unit)

    def unread(self, unit: int) -> int:
        """Count the parameters that were never read from the unit since the server started."""
        known = self._live.units[unit].parameters
        return sum(number not in known for number in PARAMETERS)

    def summary(self, unit: int, translator: Translator, now: UnixTime) -> Drifted:
        """Return the drift as one line of text, with a key of the list on the unit's page."""
        if unit not in self._golden:
            return Drifted()
        found = self.differing(unit)
        text = translator.t(_summary(found, translator.formats, now)) if found else ""
        return Drifted(text, f"{self.unread(unit)}:{','.join(one.key for one in found)}")

    def _see(self, updates: Sequence[Update]) -> None:
        """Compare the units whose parameters were read."""
        read: dict[int, set[int]] = {}
        for update in updates:
            if isinstance(update, ParameterValue) and update.unit in self._golden:
                read.setdefault(update.unit, set()).add(update.number)
        for unit, numbers in read.items():
            self._compare(unit, numbers)

    def _compare(self, unit: int, numbers: Iterable[int]) -> None:
        """Compare a unit again, and search again for the causes of ``numbers``, which were just read."""
        known, golden = self._found.get(unit, {}), self._golden[unit]
        present = known_rows(self._live.units[unit])
        found: dict[int, DriftedParameter] = {}
        for row in drift_rows(golden, present):
            one = DriftedParameter(row, golden.rows[row.number], present.rows[row.number])
            earlier = known.get(row.number)
            if earlier is not None and earlier.is_of_same_value(one):
                one = replace(one, change=earlier.change, traced=earlier.traced)
            found[row.number] = one
        self._found[unit] = found
        read = frozenset(numbers)
        untraced = [one for one in found.values() if not one.traced or one.row.number in read]
        if untraced:
            self.background.begin(self._trace(unit, untraced), f"who changed unit {unit} of {self._bus}")

    async def _trace(self, unit: int, departures: list[DriftedParameter]) -> None:
        before = self.differing(unit)
        for one in departures:
            change = await _command_of(self._events, self._bus, unit, one)
            found = self._found.get(unit, {})
            present = found.get(one.row.number)
            if present is not None and present.is_of_same_value(one):
                found[one.row.number] = replace(one, change=change, traced=True)
        if self.differing(unit) != before:
            for subscriber in self._subscribers:
                subscriber(unit)


def _without_measure(value: Message) -> Message:
    inner = value.params["value"] if value.code == "value_in_measure" else value
    return inner if isinstance(inner, Message) else value


def drift_rows(golden: UnitRows, live: UnitRows) -> list[ParameterDifference]:
    """Return the rows in which a unit differs from its golden set; setpoints do not count."""
    return [row for row in differences(golden, live) if row.number not in OPERATING_VALUES]


def _summary(found: list[DriftedParameter], formats: Formats, now: UnixTime) -> Message:
    differing: dict[str, ParamValue] = {"n": len(found), "number": found[0].row.number}
    if not all(one.traced for one in found):
        return Message("drift", differing)
    at_keypad = sum(one.change is None for one in found)
    if at_keypad == len(found):
        return Message("drift_at_panel", differing)
    people = _latest_of_each(found)
    authors = [{"who": one["who"], "when": formats.since(one["time"], now)} for one, _ in people]
    if len(people) == 1 and not at_keypad:
        return Message("drift_by", differing | authors[0])
    parts = [
        Message.of("drift_part_by", rows=rows, **author)
        for author, (_, rows) in zip(authors, people, strict=True)
    ]
    if at_keypad:
        parts.append(Message.of("drift_part_at_panel", rows=at_keypad))
    return Message.of("drift_parts", count=len(found), parts=listed(parts))


def _latest_of_each(found: list[DriftedParameter]) -> list[tuple[Event, int]]:
    """Return each person's last change, newest first, with the number of changed rows."""
    by_person: dict[str, list[Event]] = {}
    for one in found:
        if one.change is not None:
            by_person.setdefault(one.change["who"], []).append(one.change)
    latest = [
        (max(events, key=lambda event: float(event["time"])), len(events)) for events in by_person.values()
    ]
    return sorted(latest, key=lambda each: -float(each[0]["time"]))


_ACTED = ("verified", "acknowledged", "unverified", None)
"""The outcomes after which the unit may have the value; None: it was read before the outcome was stored."""
MAX_EVENTS = 20
"""The newest events of a parameter to examine; refused commands are among them."""


async def _command_of(events: EventLog, bus: str, unit: int, one: DriftedParameter) -> Event | None:
    """Find the write, later than the golden set, that made the value what it is; None for a change at the
    keypad."""
    at_unit = Filter(kind="command", bus=bus, unit=unit, since=one.before.read_at)
    wanted = replace(at_unit, code="event_write_parameter", number=one.row.number)
    for event in (await events.page(wanted, MAX_EVENTS))[0]:
        if event["outcome"] in _ACTED:
            # Events hold no secret: only its last write can be named.
            is_known = PARAMETERS[one.row.number].secret or event["new_raw"] == one.after.raw
            return event if is_known else None
    old, new = one.before.raw, one.after.raw
    if old is None or new is None:
        return None
    # A former version stored no parameter number: look for the two values.
    found, _ = await events.page(replace(at_unit, old_raw=old, new_raw=new), MAX_EVENTS)
    return next((event for event in found if not event["messages"] and event["outcome"] in _ACTED), None)
