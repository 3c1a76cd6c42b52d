"""Undo: the values that people's commands changed, and the commands that restore them.

The setpoint of a unit, an output, the analog output and a parameter are each one place. A command can be
undone for a minute, while every value that it set is still there and no newer command of its sender has set
one of them. Once a command was undone, the one before it can be undone.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from app.core.web.access import Person
from app.errors import Problem
from app.line.commands.catalogue import kind_of_command
from app.line.commands.record import CommandRequest
from app.line.commands.review import REVIEW_LASTS_S, present_setpoint
from app.line.commands.rules import staged_setpoints
from app.line.commands.values import Scales, parameter_message, scales_of, setpoint_message
from app.line.live.bus_live import BusLive
from bus.catalogue.parameters import CONTROL_MODE, PARAMETERS
from bus.catalogue.values import output_is_on
from bus.contract import (
    Action,
    ExecuteAll,
    ExecuteSpeed,
    Result,
    SetLine,
    SetSpeed,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.instants import Monotonic, MonotonicClock, UnixTime, unix_now
from bus.messages import Message, term

PlaceKind = Literal["setpoint", "output", "analog", "parameter"]


class ValuePlace(NamedTuple):
    """The place in which a unit keeps a value. ``number``: of the output or parameter; else 0."""

    kind: PlaceKind
    unit: int
    number: int = 0


Values = Mapping[ValuePlace, int]
"""The raw value of each place; an output is 0 or 1."""


def values_set(action: Action, bus: BusLive) -> Values | None:
    """Return the values that a command sets; None for a command that changes more, or something else. A unit
    outside a change of several keeps its speed and what it holds staged
    (``bus/line/commands/staging.py``)."""
    match action:
        case SetSpeed(unit=unit, raw=raw, execute=True):
            return {ValuePlace("setpoint", unit): raw}
        case ExecuteSpeed(unit=unit):
            staged = bus.units[unit].staged
            return None if staged is None else {ValuePlace("setpoint", unit): staged}
        case SetLine(setpoints=setpoints):
            return {ValuePlace("setpoint", unit): raw for unit, raw in setpoints.items()}
        case ExecuteAll():
            return {ValuePlace("setpoint", unit): raw for unit, raw in staged_setpoints(bus).items()} or None
        case WriteOutput(unit=unit, number=number, on=on):
            return {ValuePlace("output", unit, number): int(on)}
        case WriteAnalogOutput(unit=unit, raw=raw):
            return {ValuePlace("analog", unit): raw}
        case WriteParameter(unit=unit, number=number, raw=raw) if not PARAMETERS[number].secret:
            # The unit would reject the undo: it is out of REMOTE until its keypad sets it back.
            return None if number == CONTROL_MODE else {ValuePlace("parameter", unit, number): raw}
    return None


def value_now(place: ValuePlace, bus: BusLive, analog: Mapping[int, int]) -> int | None:
    """Return the value as last read; None while it is not known. ``analog``: the value that each unit has
    acknowledged, because the analog output cannot be read."""
    unit = bus.units[place.unit]
    match place.kind:
        case "setpoint":
            return present_setpoint(bus, unit)
        case "output":
            return None if unit.reading is None else int(output_is_on(unit.reading.outputs, place.number))
        case "analog":
            return analog.get(place.unit)
        case "parameter":
            return unit.parameter_raw(place.number)


def action_for(values: Values) -> Action:
    """Return the command that sets these values: several setpoints, or a single value of any kind."""
    if len(values) > 1:
        return SetLine(setpoints={place.unit: raw for place, raw in values.items()})
    ((place, raw),) = values.items()
    match place.kind:
        case "setpoint":
            return SetSpeed(unit=place.unit, raw=raw)
        case "output":
            return WriteOutput(unit=place.unit, number=place.number, on=bool(raw))
        case "analog":
            return WriteAnalogOutput(unit=place.unit, raw=raw)
        case "parameter":
            return WriteParameter(unit=place.unit, number=place.number, raw=raw)


def is_undo(action: Action, before: Values) -> bool:
    """Return whether a command sets these values again. A change of several units may leave some of them
    out."""
    if not isinstance(action, SetLine):
        return action == action_for(before)
    back = {ValuePlace("setpoint", unit): raw for unit, raw in action.setpoints.items()}
    return bool(back) and back.items() <= before.items()


LASTS_S = 60.0
MAX_OF_A_SENDER, MAX_SENDERS = 20, 200


@dataclass(frozen=True, slots=True)
class SentCommand:
    """A command that was sent. ``new``: the values it set; ``before``: the values from before it. If
    ``before`` is empty, they are unknown: neither this command nor an earlier one of the same values can be
    undone."""

    id: str
    new: Values
    before: Values
    at: Monotonic
    scale: Values = field(default_factory=dict)
    """The parameters in which the values before and after it were shown: with others the same numbers are
    other values."""

    def ends_at(self) -> Monotonic:
        """Return when the command can no longer be undone."""
        return self.at + LASTS_S


@dataclass(slots=True)
class UndoStack:
    """The commands of each sender to one bus that can be undone, the newest last. Pure: time is passed in.
    ``holds``: returns whether these values are all still there."""

    holds: Callable[[Values], bool]
    _sent: OrderedDict[str, list[SentCommand]] = field(default_factory=OrderedDict)

    def push(self, sender: str, command: SentCommand) -> None:
        """Add the newest command of this sender, which has changed its values."""
        mine = self._sent.setdefault(sender, [])
        mine.append(command)
        oldest = command.at - REVIEW_LASTS_S
        self._sent[sender] = [each for each in mine if each.ends_at() > oldest][-MAX_OF_A_SENDER:]
        self._sent.move_to_end(sender)
        while len(self._sent) > MAX_SENDERS:
            self._sent.popitem(last=False)

    def clear(self, sender: str) -> None:
        """Forget all commands that this sender has sent."""
        self._sent.pop(sender, None)

    def undone(self, sender: str, id: str) -> None:
        """Forget a command: the values from before it are back."""
        if sender in self._sent:
            self._sent[sender] = [each for each in self._sent[sender] if each.id != id]

    def find(self, sender: str, id: str, now: Monotonic) -> SentCommand | None:
        """Return the command with this id, if it can be undone now."""
        return next((each for each in self._undoable(sender, now) if each.id == id), None)

    def reviewed(self, sender: str, id: str, now: Monotonic) -> SentCommand | None:
        """Return the command with this id, if a review of its undo that is confirmed now began in time."""
        return self.find(sender, id, now - REVIEW_LASTS_S)

    def newest(
        self, sender: str, now: Monotonic, units: Set[int], kind: PlaceKind | None = None
    ) -> SentCommand | None:
        """Return the newest command to these units, and to no other, that can be undone now. ``kind``: of its
        values, if only such are wanted."""

        def is_wanted(place: ValuePlace) -> bool:
            return place.unit in units and kind in (None, place.kind)

        return next((each for each in self._undoable(sender, now) if all(map(is_wanted, each.new))), None)

    def _undoable(self, sender: str, now: Monotonic) -> Iterator[SentCommand]:
        newer: set[ValuePlace] = set()
        for each in reversed(self._sent.get(sender, ())):
            is_open = newer.isdisjoint(each.new) and each.ends_at() > now
            if is_open and each.before and self.holds({**each.new, **each.scale}):
                yield each
            newer |= each.new.keys()


@dataclass(frozen=True, slots=True)
class UndoOffer:
    """The undo of a command as a page offers it. ``action``: the command to send; ``href``: its review;
    ``text``: what it would set; ``until``: Unix time at which the offer ends."""

    id: str
    action: Action
    href: str
    text: Message
    until: UnixTime

    @property
    def sets_speed(self) -> bool:
        """Whether it sets what the field beside it shows."""
        return isinstance(self.action, SetSpeed | SetLine)


def _has_set(new: Values, result: Result) -> bool:
    """Return whether a write has set all its values. A broadcast is followed by a read of every unit: it may
    be unverified for one to which it set nothing."""
    verified = {each.unit for each in result.units if each.outcome == "verified"}
    is_of_all = bool(new) and {place.unit for place in new} <= verified
    return is_of_all or result.outcome in ("verified", "acknowledged")


@dataclass(eq=False, slots=True)
class _Write:
    """A write under way: the values it sets, those just before it, and the scale of both. ``alone``: whether
    no other write to one of its units was under way, so that the values before it are known."""

    units: frozenset[int]
    new: Values
    before: Values
    scale: Values
    alone: bool = True


class Undoing:
    """The undo of the commands to one bus, which are followed from just before they are sent."""

    def __init__(self, bus: BusLive, clock: MonotonicClock) -> None:
        self._bus = bus
        self._clock = clock
        self._under_way: set[_Write] = set()
        self._analog: dict[int, tuple[int, UnixTime]] = {}
        """The last value of the analog output that a unit has acknowledged, and when."""
        self._stack = UndoStack(lambda values: self._now(values) == values)

    def begin(self, request: CommandRequest) -> _Write:
        """Note the values before a write is sent."""
        new = values_set(request.action, self._bus) or {}
        before = self._now(new) if request.can_be_undone else {}
        scale = _parameters(scales_of(action_for(before), self._bus) if before else {})
        scale |= _parameters(request.scales or {})
        units = kind_of_command(request.action).units_written(request.action, self._bus)
        write = _Write(frozenset(units), new, before, scale)
        for other in self._under_way:
            if write.units & other.units:
                write.alone = other.alone = False
        self._under_way.add(write)
        return write

    def end(self, write: _Write, request: CommandRequest, result: Result | None) -> None:
        """Note the values that a write has changed; ``result`` None: it was given up."""
        self._under_way.discard(write)
        if result is not None and isinstance(request.action, ExecuteAll):
            # A unit that took no part keeps what it holds staged.
            done = {each.unit for each in result.units if each.outcome == "verified"}
            write.new = {place: raw for place, raw in write.new.items() if place.unit in done}
            write.before = {place: raw for place, raw in write.before.items() if place.unit in done}
        if result is None or not _has_set(write.new, result):
            return
        self._analog |= {
            place.unit: (raw, unix_now()) for place, raw in write.new.items() if place.kind == "analog"
        }
        sender = request.person.sender
        if request.undoes:
            self._stack.undone(sender, request.undoes)
        elif request.can_be_undone and write.new and request.key is not None:
            before = write.before if write.alone and write.before != write.new else {}
            self._stack.push(sender, SentCommand(request.key, write.new, before, self._clock(), write.scale))

    def refuse_over(self, request: CommandRequest) -> None:
        """Raise Problem 409 for the undo of a command whose values have changed since its review, or an undo
        that would set anything but the former values."""
        if not request.undoes:
            return
        sent = self._stack.reviewed(request.person.sender, request.undoes, self._clock())
        if sent is None or not is_undo(request.action, sent.before):
            raise Problem(409, "moved", Message("undo_over"))

    def offer(self, person: Person, id: str) -> UndoOffer | None:
        """Return the undo of this person's command; None if it cannot be undone now."""
        return self._offered(self._stack.find(person.sender, id, self._clock()))

    def newest(
        self, person: Person, units: Set[int], kind: PlaceKind | None = None, *, names_unit: bool = False
    ) -> UndoOffer | None:
        """Return the undo of this person's newest command to these units, and to no other, if it can be
        undone now: the page of a unit offers no undo of a change of several. ``kind``: of its values, if only
        such are wanted; ``names_unit``: for a page of several units."""
        found = self._stack.newest(person.sender, self._clock(), units, kind)
        return self._offered(found, names_unit=names_unit)

    def clear(self, person: Person) -> None:
        """Forget all commands of this person, so that none can be undone: the line is set to zero."""
        self._stack.clear(person.sender)

    def _offered(self, sent: SentCommand | None, *, names_unit: bool = False) -> UndoOffer | None:
        if sent is None:
            return None
        action = action_for(sent.before)
        until = unix_now() + LASTS_S - (self._clock() - sent.at)
        href = f"/bus/{self._bus.settings.name}/undo/{sent.id}"
        return UndoOffer(sent.id, action, href, _text(action, self._bus, names_unit=names_unit), until)

    def values_now(self, places: Iterable[ValuePlace]) -> dict[ValuePlace, int | None]:
        """Return the values as last read, or as last acknowledged if nothing can be read; None if not
        known."""
        analog = {
            unit: raw
            for unit, (raw, at) in self._analog.items()
            if self._bus.units[unit].link.link == "online" and self._bus.units[unit].link.at < at
        }
        return {place: value_now(place, self._bus, analog) for place in places}

    def _now(self, places: Values) -> dict[ValuePlace, int]:
        """Return the present values; empty if one of them is not known."""
        found = self.values_now(places)
        known = {place: raw for place, raw in found.items() if raw is not None}
        return known if len(known) == len(found) else {}


def _parameters(scales: Scales) -> dict[ValuePlace, int]:
    """Return the parameters of scales as places, as far as the units have them."""
    return {
        ValuePlace("parameter", unit, number): raw
        for unit, scale in scales.items()
        for number, raw in scale.items()
        if raw is not None
    }


_OF_UNIT = {
    "undo_setpoint": "undo_setpoint_of",
    "undo_output": "undo_output_of",
    "undo_analog": "undo_analog_of",
    "undo_parameter": "undo_parameter_of",
}
"""The text of an undo that also names the unit."""


def _text(action: Action, bus: BusLive, *, names_unit: bool) -> Message:
    match action:
        case SetSpeed(unit=unit, raw=raw):
            text = Message.of("undo_setpoint", value=setpoint_message(raw, bus.units[unit]))
        case WriteOutput(number=number, on=on):
            text = Message.of("undo_output", number=number, state=term("on") if on else term("off"))
        case WriteAnalogOutput(raw=raw):
            text = Message.of("undo_analog", value=raw)
        case WriteParameter(unit=unit, number=number, raw=raw):
            value = parameter_message(PARAMETERS[number], raw, bus.units[unit])
            text = Message.of("undo_parameter", number=number, value=value)
        case _:
            return Message("undo_setpoints")
    if not names_unit:
        return text
    return Message(_OF_UNIT[text.code], {**text.params, "unit": bus.units[action.units[0]].settings.name})
