"""Follows the commands of people from just before they are sent, so that each can be undone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Set
from contextlib import contextmanager
from dataclasses import dataclass, field

from app.core.web.access import Person
from app.errors import Problem
from app.line.commands.catalogue import kind_of_command
from app.line.commands.service.command_request import CommandRequest
from app.line.commands.undo.changes import ValuePlace, Values, action_for, is_undo, value_now, values_set
from app.line.commands.undo.overlap import WritesUnderWay
from app.line.commands.undo.stack import LASTS_S, SentCommand, UndoStack
from app.line.commands.values import Scales, scales_of
from app.line.live.bus_live import BusLive
from bus.contract import Action, Result
from bus.instants import MonotonicClock, UnixTime, unix_now
from bus.messages import Message

CHANGED = ("verified", "acknowledged")


@dataclass(frozen=True, slots=True)
class UndoOffer:
    """``action``: what it would send; ``until``: Unix time at which the offer ends."""

    bus: str
    id: str
    action: Action
    until: UnixTime


@dataclass(eq=False)
class Undoing:
    """Of one bus."""

    _bus: BusLive
    _clock: MonotonicClock
    _writes: WritesUnderWay = field(default_factory=WritesUnderWay)
    _analog: dict[int, tuple[int, UnixTime]] = field(default_factory=dict)
    """The last value of the analog output that a unit has acknowledged, and when."""

    def __post_init__(self) -> None:
        self._stack = UndoStack(lambda values: self._now(values) == values)

    @contextmanager
    def of(self, request: CommandRequest) -> Iterator[Callable[[Result], Result]]:
        """While a write is sent and followed; pass its result to what this gives."""
        if not request.action.writes:
            yield lambda result: result
            return
        new = values_set(request.action, self._bus) or {}
        before = self._now(new)
        scale = _parameters(scales_of(action_for(before), self._bus) if before else {})
        scale |= _parameters(request.scales or {})
        results: list[Result] = []

        def follow(result: Result) -> Result:
            results.append(result)
            return result

        number = self._writes.begin(kind_of_command(request.action).units_written(request.action, self._bus))
        try:
            yield follow
        finally:
            alone = self._writes.end(number)
            for result in results:
                self._note(request, result, new, before if alone else {}, scale)

    def _note(
        self, request: CommandRequest, result: Result, new: Values, before: Values, scale: Values
    ) -> None:
        if result.outcome not in CHANGED:
            return
        self._analog |= {
            place.unit: (raw, unix_now()) for place, raw in new.items() if place.kind == "analog"
        }
        sender = request.person.sender
        if request.undoes:
            self._stack.undone(sender, request.undoes)
        elif request.can_be_undone and new and request.key is not None:
            known = before if before != new else {}
            self._stack.push(sender, SentCommand(request.key, new, known, self._clock(), scale))

    def refuse_over(self, request: CommandRequest) -> None:
        """Raises Problem 409 for the undo of a command of which something has changed since its review, or
        that would set something else than what was there before."""
        if not request.undoes:
            return
        sent = self._stack.reviewed(request.person.sender, request.undoes, self._clock())
        if sent is None or not is_undo(request.action, sent.before):
            raise Problem(409, "moved", Message("undo_over"))

    def offer(self, person: Person, id: str) -> UndoOffer | None:
        """The undo of this person's command; None where it cannot be undone now."""
        return self._offered(self._stack.find(person.sender, id, self._clock()))

    def newest(self, person: Person, units: Set[int]) -> UndoOffer | None:
        """The undo of this person's newest command to one of these units, where it can be undone now."""
        return self._offered(self._stack.newest(person.sender, self._clock(), units))

    def clear(self, person: Person) -> None:
        """Nothing that this person has sent is undone any more: the line is set to zero."""
        self._stack.clear(person.sender)

    def _offered(self, sent: SentCommand | None) -> UndoOffer | None:
        if sent is None:
            return None
        until = unix_now() + LASTS_S - (self._clock() - sent.at)
        return UndoOffer(self._bus.settings.name, sent.id, action_for(sent.before), until)

    def values_now(self, places: Iterable[ValuePlace]) -> dict[ValuePlace, int | None]:
        """What these are as last read, and as last acknowledged where nothing can be read; None where that is
        not known."""
        analog = {
            unit: raw
            for unit, (raw, at) in self._analog.items()
            if self._bus.units[unit].link.link == "online" and self._bus.units[unit].link.at < at
        }
        return {place: value_now(place, self._bus, analog) for place in places}

    def _now(self, places: Values) -> dict[ValuePlace, int]:
        """What these are now; empty where one of them is not known."""
        found = self.values_now(places)
        known = {place: raw for place, raw in found.items() if raw is not None}
        return known if len(known) == len(found) else {}


def _parameters(scales: Scales) -> dict[ValuePlace, int]:
    """What values are shown with, as far as the units have these parameters."""
    return {
        ValuePlace("parameter", unit, number): raw
        for unit, scale in scales.items()
        for number, raw in scale.items()
        if raw is not None
    }
