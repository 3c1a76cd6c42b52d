"""What each sender has gathered in the change tray of one bus. Pure: time is passed in.

A tray holds one raw value for each place: a setpoint, an output, the analog output or a parameter of a unit.
Nothing of it is a command before it is reviewed and sent.
"""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from typing import NamedTuple, get_args

from app.errors import Problem
from app.line.commands.undo.changes import PlaceKind, ValuePlace, Values
from bus.contract import UnitScale
from bus.instants import Monotonic
from bus.messages import Message

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
