"""What each sender has gathered in the change tray of one bus. Pure: time is passed in.

A tray holds one raw value for each place: a setpoint, an output, the analog output or a parameter of a unit.
Nothing of it is a command before it is reviewed and sent.

What the review of a change tray shows of each change: from which value to which, with what consequence,
and why it cannot be sent now. Pure.
"""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, get_args

from app.engineering.sets.model import status_of
from app.engineering.sets.restore_plan import warning_of
from app.errors import Problem
from app.line.commands.review import SetpointChange
from app.line.commands.undo.changes import PlaceKind, ValuePlace, Values, action_for
from app.line.commands.values import measure_of_value, parameter_message
from app.line.live.bus_live import BusLive, UnitLive, follower
from bus.catalogue.parameter import danger_of_writing
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Action, UnitScale
from bus.instants import Monotonic
from bus.messages import Message, number, term

LASTS_S = 8 * 3600.0
"""A tray that nothing was added to for a shift is empty."""
MAX_CHANGES, MAX_TRAYS = 512, 200
KINDS: tuple[PlaceKind, ...] = get_args(PlaceKind)
"""In the order in which they are sent."""
_KEY = re.compile(rf"({'|'.join(KINDS)})-(\d{{1,3}})-(\d{{1,2}})", re.ASCII)


def key_of(place: ValuePlace) -> str:
    """The place as forms and programs name it: ``parameter-3-6``."""
    return f"{place.kind}-{place.unit}-{place.number}"


def place_of(key: str) -> ValuePlace | None:
    """The place of a key; None for a text that is none."""
    found = _KEY.fullmatch(key)
    if found is None:
        return None
    kind = next(each for each in KINDS if each == found[1])
    return ValuePlace(kind, int(found[2]), int(found[3]))


def steps_of(changes: Values) -> list[Values]:
    """The changes in the order of sending: all setpoints together, then each output, analog output and
    parameter, of one kind in the order in which they were added."""
    by_kind = [{place: raw for place, raw in changes.items() if place.kind == kind} for kind in KINDS]
    together, *others = by_kind
    alone: Iterator[Values] = ({place: raw} for kind in others for place, raw in kind.items())
    return [*([together] if together else []), *alone]


PlaceScales = Mapping[ValuePlace, UnitScale]
"""What each change was shown with when it was added."""


class _Tray(NamedTuple):
    changes: Values
    scales: PlaceScales
    added_at: Monotonic


class Trays:
    """The trays of one bus, each of a sender (`Person.sender`)."""

    def __init__(self) -> None:
        self._trays: OrderedDict[str, _Tray] = OrderedDict()

    def of(self, sender: str, now: Monotonic) -> Values:
        """What this sender has gathered, in the order in which it was added."""
        tray = self._trays.get(sender)
        return {} if tray is None or now - tray.added_at >= LASTS_S else tray.changes

    def scales_of(self, sender: str) -> PlaceScales:
        """What the changes of this sender were shown with when they were added."""
        tray = self._trays.get(sender)
        return {} if tray is None else tray.scales

    def add(self, sender: str, changes: Values, now: Monotonic, scales: PlaceScales) -> None:
        """Add changes; the former one of the same place is replaced. Raises Problem 422 for too many."""
        held = {**self.of(sender, now), **changes}
        if len(held) > MAX_CHANGES:
            raise Problem(422, "invalid", Message.of("tray_full", most=MAX_CHANGES))
        self._trays[sender] = _Tray(held, {**self.scales_of(sender), **scales}, now)
        self._trays.move_to_end(sender)
        while len(self._trays) > MAX_TRAYS:
            self._trays.popitem(last=False)

    def remove(self, sender: str, changes: Values) -> None:
        """Remove changes; one that has another value by now stays."""
        tray = self._trays.get(sender)
        if tray is None:
            return
        left = {place: raw for place, raw in tray.changes.items() if changes.get(place) != raw}
        if left:
            self._trays[sender] = tray._replace(changes=left)
        else:
            del self._trays[sender]


ON_OFF = (term("off"), term("on"))


@dataclass(frozen=True, slots=True)
class TrayRow:
    """One change. ``was``: the present raw value, None where it is not known; ``old``: the same in words,
    empty then. ``effect``: what follows from it; ``warning``: the same, where a person must know it.
    ``refusal``: why it cannot be sent now, None where nothing is known against it; ``danger``: why it has to
    be confirmed."""

    place: ValuePlace
    raw: int
    was: int | None
    name: str
    what: Message
    old: str | Message
    new: str | Message
    measure: str | Message
    effect: Message
    refusal: Message | None
    warnings: tuple[Message, ...] = ()
    danger: str = ""

    @property
    def key(self) -> str:
        """The name of its place in a form."""
        return key_of(self.place)

    @property
    def was_text(self) -> str:
        """What a form holds of the present value."""
        return "" if self.was is None else str(self.was)

    @property
    def reviewed(self) -> str:
        """What the form of a review holds of it: its place, the new and the present value."""
        return f"{self.key}:{self.raw}:{self.was_text}"


class Unable(NamedTuple):
    """A unit of which a change cannot be sent now: all of the others or none, until a person leaves it
    out."""

    unit: int
    name: str
    obstacle: Message


@dataclass(frozen=True, slots=True)
class Judge:
    """The state of the units when a tray is reviewed. ``change``: what a new setpoint means for a unit;
    ``obstacle``: why a unit takes no command now; ``refusal``: why this command would be refused;
    ``other_scale``: why its value is another one by now."""

    bus: BusLive
    values: Mapping[ValuePlace, int | None]
    change: Callable[[int, int], SetpointChange]
    obstacle: Callable[[int], Message | None]
    refusal: Callable[[Action], Message | None]
    other_scale: Callable[[ValuePlace], Message | None]

    def rows(self, changes: Values) -> list[TrayRow]:
        """In the order in which they are sent; setpoints in floor order."""
        floor = {unit: at for at, unit in enumerate(self.bus.units)}
        steps = [sorted(step.items(), key=lambda change: floor[change[0].unit]) for step in steps_of(changes)]
        return [self._row(place, raw) for step in steps for place, raw in step]

    def _row(self, place: ValuePlace, raw: int) -> TrayRow:
        refusal = self.obstacle(place.unit) or self.other_scale(place)
        refusal = refusal or self.refusal(action_for({place: raw}))
        was = self.values[place]
        match place.kind:
            case "setpoint":
                return self._of_setpoint(place, raw, refusal)
            case "output":
                return self._of_output(place, raw, was, refusal)
            case "analog":
                return TrayRow(
                    place=place,
                    raw=raw,
                    was=was,
                    name=self._unit(place).settings.name,
                    what=term("Analog output"),
                    old="" if was is None else str(was),
                    new=str(raw),
                    measure="",
                    effect=Message("tray_analog_unread"),
                    refusal=refusal,
                )
            case "parameter":
                return self._of_parameter(place, raw, was, refusal)

    def _of_setpoint(self, place: ValuePlace, raw: int, refusal: Message | None) -> TrayRow:
        change = self.change(place.unit, raw)
        return TrayRow(
            place=place,
            raw=raw,
            was=change.old_raw,
            name=change.name,
            what=term("Ratio") if follower(self._unit(place)) else term("Setpoint"),
            old=change.old,
            new=change.new,
            measure=change.measure,
            effect=_ramp(change),
            refusal=refusal,
            warnings=change.risks,
        )

    def _of_output(self, place: ValuePlace, raw: int, was: int | None, refusal: Message | None) -> TrayRow:
        settings = self._unit(place).settings
        label = settings.labels.output.get(place.number, "")
        return TrayRow(
            place=place,
            raw=raw,
            was=was,
            name=settings.name,
            what=Message.of("tray_output_named" if label else "tray_output", n=place.number, name=label),
            old="" if was is None else ON_OFF[was],
            new=ON_OFF[raw],
            measure="",
            effect=term("The equipment on this output reacts immediately."),
            refusal=refusal,
        )

    def _of_parameter(self, place: ValuePlace, raw: int, was: int | None, refusal: Message | None) -> TrayRow:
        unit, parameter = self._unit(place), PARAMETERS[place.number]
        status = status_of(self.bus, unit)
        warning = warning_of(parameter.number, raw, running=None if status is None else status.run)
        return TrayRow(
            place=place,
            raw=raw,
            was=was,
            name=unit.settings.name,
            what=Message.of("tray_parameter", number=parameter.number, called=parameter.name),
            old="" if was is None else parameter_message(parameter, was, unit),
            new=parameter_message(parameter, raw, unit),
            measure=measure_of_value(unit, parameter, raw),
            effect=term(parameter.meaning),
            refusal=refusal,
            warnings=() if warning is None else (warning,),
            danger=danger_of_writing(parameter, raw),
        )

    def _unit(self, place: ValuePlace) -> UnitLive:
        return self.bus.units[place.unit]


def _ramp(change: SetpointChange) -> Message:
    if change.old_raw == change.new_raw:
        return term("no change")
    if change.ramp is None:
        return Message("tray_follows_master")
    if change.ramp.seconds is None:
        return term("with the unit's own ramp; duration unknown")
    return Message.of("tray_ramp", seconds=number(f"{change.ramp.seconds:.1f}"))


def unable_units(rows: Iterable[TrayRow]) -> dict[int, Unable]:
    """By its address each unit of which a change cannot be sent now, with the first reason."""
    found: dict[int, Unable] = {}
    for row in rows:
        if row.refusal is not None:
            found.setdefault(row.place.unit, Unable(row.place.unit, row.name, row.refusal))
    return found
