"""Values as a unit shows them. Pure."""

from __future__ import annotations

from app.live.api.view import setpoint_text
from app.live.state.bus_live import UnitLive, follower
from bus.catalogue.numbers import DECIMALS
from bus.catalogue.parameter import Parameter
from bus.catalogue.values import parameter_text
from bus.messages import Message, number, term


def shown_setpoint(raw: int | None, live: UnitLive) -> str:
    """A setpoint as the unit shows it; the bare integer, marked, while its decimals are not known."""
    return "" if raw is None else setpoint_text(live, raw) or f"{raw} raw"


def setpoint_message(raw: int | None, live: UnitLive) -> str | Message:
    """The same as a message; empty where there is none."""
    return "" if raw is None else _number(shown_setpoint(raw, live), raw)


def parameter_message(parameter: Parameter, raw: int, live: UnitLive) -> Message:
    """A value of a parameter: a choice by its name, a number in this unit's decimals and mode."""
    text = text_of(parameter, raw, live)
    return term(text) if parameter.secret or raw in parameter.choices else _number(text, raw)


def _number(text: str, raw: int) -> Message:
    return Message.of("raw_value", raw=raw) if text == f"{raw} raw" else number(text)


def known_parameter_text(parameter: Parameter, live: UnitLive) -> str:
    """A parameter as last read, as people read it; empty when it never was."""
    raw = live.parameter_raw(parameter.number)
    return "" if raw is None else text_of(parameter, raw, live)


def text_of(parameter: Parameter, raw: int, live: UnitLive) -> str:
    """A value of a parameter in this unit's decimals and mode."""
    return parameter_text(parameter, raw, live.parameter_raw(DECIMALS), follower=bool(follower(live)))
