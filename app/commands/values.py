"""Values as a unit shows them. Pure."""

from __future__ import annotations

from app.live.api.view import setpoint_text
from app.live.state.bus_live import UnitLive, follower
from bus.catalogue import values
from bus.catalogue.numbers import DECIMALS
from bus.catalogue.parameter import Parameter
from bus.messages import Message, number


def setpoint_message(raw: int | None, live: UnitLive) -> str | Message:
    """A setpoint as the unit shows it, the bare integer, marked, while its decimals are not known; empty
    where there is none."""
    if raw is None:
        return ""
    text = setpoint_text(live, raw)
    return values.bare(raw) if text is None else number(text)


def parameter_message(parameter: Parameter, raw: int, live: UnitLive) -> Message:
    """A value of a parameter: a choice by its name, a number in this unit's decimals and mode."""
    decimals = live.parameter_raw(DECIMALS)
    return values.parameter_message(parameter, raw, decimals, follower=bool(follower(live)))
