"""What the API accepts in the body of a command: strict, nothing unknown, nothing converted."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated

from pydantic import Field, StringConstraints, model_validator

from app.core.web.shape import StrictBody
from bus.messages import Message

TimeoutS = Annotated[float, Field(ge=0.05, le=30)]
"""How long a write may wait for the wire, seconds; after that it is dropped."""
UnitKey = Annotated[str, StringConstraints(pattern=r"^[1-9][0-9]{0,2}$")]
TypedValue = str | int | float


class CommandRequestBody(StrictBody):
    """What the body of every command may hold."""

    timeout_s: Annotated[
        TimeoutS | None, Field(description="Time that it may wait for the wire, 0.05 to 30 s; else 2 s.")
    ] = None
    confirm: Annotated[bool, Field(description="Confirms a dangerous value or a large step.")] = False


class Quantity(StrictBody):
    """A raw integer of the wire, or the value as displayed; not both."""

    raw: Annotated[int | None, Field(description="Integer on the wire, 0 to 99999.")] = None
    value: Annotated[
        TypedValue | None,
        Field(description="As the unit displays it, such as 1234.5; of a setpoint also 105 % of its own."),
    ] = None

    @model_validator(mode="after")
    def _is_given_once(self) -> Quantity:
        if (self.raw is None) == (self.value is None):
            raise ValueError(Message("raw_or_value"))
        if isinstance(self.value, bool):
            raise ValueError(Message("value_not_a_number"))
        return self

    @property
    def typed(self) -> str:
        """The value as a person would type it; empty when ``raw`` is given."""
        if isinstance(self.value, float):
            return f"{Decimal(repr(self.value)).normalize():f}"
        return "" if self.value is None else str(self.value)


class SpeedRequest(CommandRequestBody, Quantity):
    """``execute`` true: 84h, immediately; false: 82h, staged until executed."""

    execute: bool = True


class ParameterRequest(CommandRequestBody, Quantity):
    """The new value of a parameter."""


class OutputRequest(CommandRequestBody):
    """Requested state of an auxiliary output."""

    on: bool


class BaudRequest(CommandRequestBody):
    """The baud rate that every unit of a bus shall have (#18)."""

    baud: Annotated[int, Field(description="300, 600, 1200, 2400, 4800 or 9600 bit/s.")]


class AnalogOutputRequest(CommandRequestBody):
    """The value of 88h, #29 to #30."""

    raw: Annotated[int, Field(description="Integer on the wire, #29 (0 V) to #30 (10 V).")]


class SpeedsRequest(CommandRequestBody):
    """The setpoints of one change, by unit."""

    setpoints: Annotated[dict[UnitKey, Quantity], Field(min_length=1)]
