"""What new setpoints do to the draw between neighboring sections, before they are confirmed. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from decimal import Decimal
from typing import NamedTuple

from app.line.commands.values import in_measure, measure_of_setpoint, setpoint_message
from app.line.conditions.draw import Draw, SectionSpeed, draw_between, percent_of
from app.line.live.state.bus_live import BusLive, UnitLive, follower
from app.line.live.state.draw import quantity_of
from bus.catalogue.numbers import DECIMALS
from bus.messages import Message, number
from bus.settings import Seam


class DrawChange(NamedTuple):
    """A draw that becomes another one. ``is_out``: out of the band that the site sets for it."""

    text: Message
    is_out: bool


def draw_changes(bus: BusLive, setpoints: Mapping[int, int]) -> list[DrawChange]:
    """Each draw that these setpoints, raw by unit, change to one that is not within a band, in floor order.
    A unit without a new one stays at its commanded speed. A follower has a ratio: nothing is known of it."""
    return list(_changes(bus, setpoints))


def _changes(bus: BusLive, setpoints: Mapping[int, int]) -> Iterator[DrawChange]:
    for unit, seam in bus.seams.items():
        if setpoints.keys().isdisjoint((unit, seam.before)):
            continue
        pair = bus.units[seam.before], bus.units[unit]
        if any(map(follower, pair)):
            continue
        now, then = _draw(bus, pair, seam, {}), _draw(bus, pair, seam, setpoints)
        if then.tenths is None or then.tenths == now.tenths or then.state == "in_band":
            continue
        is_out = then.state == "out_of_band"
        text = _text(*pair, setpoints, _percent(percent_of(then.tenths), "+"))
        yield DrawChange(_with_band(text, seam) if is_out else text, is_out)


def _draw(bus: BusLive, pair: tuple[UnitLive, UnitLive], seam: Seam, setpoints: Mapping[int, int]) -> Draw:
    before, unit = pair
    return draw_between(_speed(bus, before, setpoints), _speed(bus, unit, setpoints), seam.band)


def _speed(bus: BusLive, unit: UnitLive, setpoints: Mapping[int, int]) -> SectionSpeed:
    """A unit that stands, whatever is commanded, stays standing."""
    raw = setpoints.get(unit.settings.id)
    if raw is None and unit.reading is not None:
        raw = 0 if unit.reading.actual == 0 else unit.reading.commanded
    return SectionSpeed(raw, unit.parameter_raw(DECIMALS), quantity_of(bus, unit))


def _text(before: UnitLive, unit: UnitLive, setpoints: Mapping[int, int], draw: Message) -> Message:
    names = {"name": unit.settings.name, "before": before.settings.name}
    if unit.settings.id not in setpoints:
        return Message.of("draw_after_stays", **names, speed=_stays_at(unit), draw=draw)
    if before.settings.id not in setpoints:
        return Message.of("draw_before_stays", **names, speed=_stays_at(before), draw=draw)
    return Message.of("draw_of_both", **names, draw=draw)


def _stays_at(unit: UnitLive) -> Message:
    commanded = None if unit.reading is None else unit.reading.commanded
    return in_measure(setpoint_message(commanded, unit), measure_of_setpoint(unit))


def _with_band(text: Message, seam: Seam) -> Message:
    low, high = map(_percent, seam.band)
    return Message.of("draw_and_band", text=text, low=low, high=high)


def _percent(percent: Decimal, sign: str = "") -> Message:
    return number(f"{percent:{sign}}".replace("-", "\N{MINUS SIGN}"))
