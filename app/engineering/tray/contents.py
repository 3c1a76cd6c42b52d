"""The change trays of one bus, and the row that a review shows for each change. Pure.

A tray holds one raw value for each place: a setpoint, an output, the analog output or a parameter of a unit.
Nothing in a tray is a command before it is reviewed and sent.
"""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, get_args

from app.engineering.sets.model import status_of
from app.errors import Problem
from app.line.commands.effects import warning_of
from app.line.commands.review import SetpointChange
from app.line.commands.undo import PlaceKind, ValuePlace, Values
from app.line.commands.values import measure_of_value, parameter_message
from app.line.live.bus_live import BusLive, UnitLive, follower, is_driven
from bus.catalogue.parameters import PARAMETERS, danger_of_writing
from bus.contract import UnitScale
from bus.instants import Monotonic
from bus.messages import Message, number, term

LASTS_S = 8 * 3600.0
"""The time after which an unchanged tray is empty: one shift."""
MAX_CHANGES, MAX_TRAYS = 512, 200
KINDS: tuple[PlaceKind, ...] = get_args(PlaceKind)
"""The kinds of places, in the order of sending."""
_KEY = re.compile(rf"({'|'.join(KINDS)})-(\d{{1,3}})-(\d{{1,2}})", re.ASCII)


def key_of(place: ValuePlace) -> str:
    """Return the name of a place in forms, such as ``parameter-3-6``."""
    return f"{place.kind}-{place.unit}-{place.number}"


def place_of(key: str) -> ValuePlace | None:
    """Parse the name of a place in a form; None if it is not valid."""
    found = _KEY.fullmatch(key)
    if found is None:
        return None
    kind = next(each for each in KINDS if each == found[1])
    return ValuePlace(kind, int(found[2]), int(found[3]))


def steps_of(changes: Values) -> list[Values]:
    """Put changes in the order of sending: all setpoints together, then each output, analog output and
    parameter, within a kind in the order of adding."""
    by_kind = [{place: raw for place, raw in changes.items() if place.kind == kind} for kind in KINDS]
    together, *others = by_kind
    alone: Iterator[Values] = ({place: raw} for kind in others for place, raw in kind.items())
    return [*([together] if together else []), *alone]


PlaceScales = Mapping[ValuePlace, UnitScale]
"""The scale that showed each change when it was added."""


class Tray(NamedTuple):
    """The changes that one sender has added and not sent yet, in the order of adding, and the time of the
    last."""

    changes: Values
    scales: PlaceScales
    added_at: Monotonic


class Trays:
    """The trays of one bus, by sender (`Person.sender`)."""

    def __init__(self) -> None:
        self._trays: OrderedDict[str, Tray] = OrderedDict()

    def changes(self, sender: str, now: Monotonic) -> Values:
        """Return the changes that a sender has gathered, in the order of adding."""
        tray = self._trays.get(sender)
        return {} if tray is None or now - tray.added_at >= LASTS_S else tray.changes

    def scales(self, sender: str) -> PlaceScales:
        """Return the scales that showed a sender's changes when they were added."""
        tray = self._trays.get(sender)
        return {} if tray is None else tray.scales

    def add(self, sender: str, changes: Values, now: Monotonic, scales: PlaceScales) -> None:
        """Add changes; a new one replaces another at the same place. Raise Problem 422 for too many."""
        held = {**self.changes(sender, now), **changes}
        if len(held) > MAX_CHANGES:
            raise Problem(422, "invalid", Message.of("tray_full", most=MAX_CHANGES))
        self.put(sender, Tray(held, {**self.scales(sender), **scales}, now))

    def tray(self, sender: str) -> Tray | None:
        """Return the tray of a sender, however old it is."""
        return self._trays.get(sender)

    def put(self, sender: str, tray: Tray) -> None:
        """Set the tray of a sender as the newest."""
        self._trays[sender] = tray
        self._trays.move_to_end(sender)
        while len(self._trays) > MAX_TRAYS:
            self._trays.popitem(last=False)

    def remove(self, sender: str, changes: Values) -> None:
        """Remove changes, except those whose value has changed meanwhile."""
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
    """A change in a review.

    ``was``: the present raw value, None if not known; ``old``: the same as text, empty if not known;
    ``refusal``: the reason why it cannot be sent now, None if none is known; ``effect``: the consequence;
    ``warnings``: for the person; ``danger``: the reason why it must be confirmed.
    """

    place: ValuePlace
    raw: int
    was: int | None
    name: str
    refusal: Message | None
    what: Message
    old: str | Message
    new: str | Message
    effect: Message
    measure: str | Message = ""
    warnings: tuple[Message, ...] = ()
    danger: str = ""

    @property
    def key(self) -> str:
        """The name of the place in a form."""
        return key_of(self.place)

    @property
    def was_text(self) -> str:
        """The present value as text in a form."""
        return "" if self.was is None else str(self.was)

    @property
    def reviewed(self) -> str:
        """The change in the form of a review: the place, the new value, the present value."""
        return f"{self.key}:{self.raw}:{self.was_text}"


class Unable(NamedTuple):
    """A unit that cannot take one of its changes now. Nothing is sent until a person leaves it out."""

    unit: int
    name: str
    obstacle: Message


def setpoint_row(
    place: ValuePlace, raw: int, change: SetpointChange, unit: UnitLive, refusal: Message | None
) -> TrayRow:
    """Return the row of a new setpoint, which ``change`` has reviewed."""
    return TrayRow(
        place=place,
        raw=raw,
        was=change.old_raw,
        name=change.name,
        refusal=refusal,
        what=term("Ratio") if follower(unit) else term("Setpoint"),
        old=change.old,
        new=change.new,
        measure=change.measure,
        effect=_ramp(change),
        warnings=change.risks,
    )


def value_row(place: ValuePlace, raw: int, was: int | None, bus: BusLive, refusal: Message | None) -> TrayRow:
    """Return the row of a new output, analog output or parameter; ``was``: the present value."""
    unit = bus.units[place.unit]
    common = (place, raw, was, unit.settings.name, refusal)
    if place.kind == "output":
        label = unit.settings.labels.output.get(place.number, "")
        return TrayRow(
            *common,
            what=Message.of("tray_output_named" if label else "tray_output", n=place.number, name=label),
            old="" if was is None else ON_OFF[was],
            new=ON_OFF[raw],
            effect=term("The equipment on this output reacts immediately."),
        )
    if place.kind == "analog":
        return TrayRow(
            *common,
            what=term("Analog output"),
            old="" if was is None else str(was),
            new=str(raw),
            effect=Message("tray_analog_unread"),
        )
    parameter, status = PARAMETERS[place.number], status_of(bus, unit)
    warning = warning_of(parameter.number, raw, running=None if status is None else is_driven(status))
    return TrayRow(
        *common,
        what=Message.of("tray_parameter", number=parameter.number, called=parameter.name),
        old="" if was is None else parameter_message(parameter, was, unit),
        new=parameter_message(parameter, raw, unit),
        measure=measure_of_value(unit, parameter, raw),
        effect=term(parameter.meaning),
        warnings=() if warning is None else (warning,),
        danger=danger_of_writing(parameter, raw),
    )


def _ramp(change: SetpointChange) -> Message:
    if change.old_raw == change.new_raw:
        return term("no change")
    if change.ramp is None:
        return Message("tray_follows_master")
    if change.ramp.seconds is None:
        return term("with the unit's own ramp; duration unknown")
    return Message.of("tray_ramp", seconds=number(f"{max(change.ramp.seconds, 0.1):.1f}"))


def unable_units(rows: Iterable[TrayRow]) -> dict[int, Unable]:
    """Return the units that cannot take one of their changes now, with the first reason, by address."""
    found: dict[int, Unable] = {}
    for row in rows:
        if row.refusal is not None:
            found.setdefault(row.place.unit, Unable(row.place.unit, row.name, row.refusal))
    return found
