"""The undo of a command as a page offers it. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from app.line.commands.service.undoing import UndoOffer
from app.line.commands.values import parameter_message, setpoint_message
from app.line.live.bus_live import BusLive
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Action, SetSpeed, WriteAnalogOutput, WriteOutput, WriteParameter
from bus.instants import UnixTime
from bus.messages import Message, term

OF_UNIT = {
    "undo_setpoint": "undo_setpoint_of",
    "undo_output": "undo_output_of",
    "undo_analog": "undo_analog_of",
    "undo_parameter": "undo_parameter_of",
}
"""The text that names the unit."""


@dataclass(frozen=True, slots=True)
class UndoShown:
    """``href``: where its review is; ``text``: what it would set; ``until``: Unix time in seconds."""

    href: str
    text: Message
    until: UnixTime


def undo_shown(offer: UndoOffer | None, bus: BusLive, *, names_unit: bool = False) -> UndoShown | None:
    """None for None. ``names_unit``: for a page of several units."""
    if offer is None:
        return None
    text = _text(offer.action, bus)
    if names_unit and len(offer.action.units) == 1:
        name = bus.units[offer.action.units[0]].settings.name
        text = Message(OF_UNIT[text.code], {**text.params, "unit": name})
    return UndoShown(f"/bus/{offer.bus}/undo/{offer.id}", text, offer.until)


def _text(action: Action, bus: BusLive) -> Message:
    match action:
        case SetSpeed(unit=unit, raw=raw):
            return Message.of("undo_setpoint", value=setpoint_message(raw, bus.units[unit]))
        case WriteOutput(number=number, on=on):
            return Message.of("undo_output", number=number, state=term("on") if on else term("off"))
        case WriteAnalogOutput(raw=raw):
            return Message.of("undo_analog", value=raw)
        case WriteParameter(unit=unit, number=number, raw=raw):
            value = parameter_message(PARAMETERS[number], raw, bus.units[unit])
            return Message.of("undo_parameter", number=number, value=value)
    return Message("undo_setpoints")
