"""What the app can request of a bus: from the app to the worker.

A new one needs a class here, a case in ``bus.line.commands.catalogue`` for how it is carried out
and verified, and a row in ``app.line.commands.catalogue`` for everything else.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta, field

from bus.contract.bounds import (
    MAX_FRAMES,
    MAX_UNITS,
    BaudRate,
    FourBytes,
    OutputNumber,
    ParameterNumber,
    Speed,
    Stamp,
    TaggedStruct,
    UnitId,
)


class BusAction(TaggedStruct, frozen=True):
    """Addresses a bus."""

    writes: ClassVar[bool] = True
    """Whether it can change anything in a unit."""
    returns_values: ClassVar[bool] = False
    """Whether its result has values of parameters, those of ``only_unit``."""
    most_frames: ClassVar[int] = 300
    """How many frames its result has at most."""

    @property
    def units(self) -> tuple[int, ...]:
        """The units that it names, ascending."""
        return ()

    @property
    def only_unit(self) -> int | None:
        """The unit that it addresses alone."""
        return None

    @property
    def stops(self) -> bool:
        """Whether it can only bring units to a standstill."""
        return False


class UnitAction(BusAction, frozen=True):
    """Addresses one unit."""

    unit: UnitId

    @property
    def units(self) -> tuple[int, ...]:
        return (self.unit,)

    @property
    def only_unit(self) -> int | None:
        return self.unit


class SetSpeed(UnitAction, frozen=True, tag="set_speed"):
    """84h (``execute``) or 82h. ``raw``: 0-99999, display units, or a ratio times 10000 for a follower."""

    raw: Speed
    execute: bool = True

    @property
    def stops(self) -> bool:
        return self.raw == 0


class ExecuteSpeed(UnitAction, frozen=True, tag="execute_speed"):
    """83h to one unit."""


class ExecuteAll(BusAction, frozen=True, tag="execute_all"):
    """83h to UID 0, then the proof from every unit."""


class SetLine(BusAction, frozen=True, tag="set_line"):
    """Stage each (82h), require every ACK, one 83h to UID 0, read each back. ``setpoints``: unit → raw."""

    setpoints: Annotated[dict[UnitId, Speed], Meta(max_length=MAX_UNITS)]

    @property
    def units(self) -> tuple[int, ...]:
        return tuple(sorted(self.setpoints))

    @property
    def stops(self) -> bool:
        return not any(self.setpoints.values())


class WriteOutput(UnitAction, frozen=True, tag="write_output"):
    """87h: ``number`` 1-6."""

    number: OutputNumber
    on: bool


class WriteAnalogOutput(UnitAction, frozen=True, tag="write_analog_output"):
    """88h: acknowledged at best, there is nothing to read back."""

    raw: FourBytes


class ReadParameters(UnitAction, frozen=True, tag="read_parameters"):
    """85h for each of ``numbers`` (all 40 when empty). Not ``urgent``: only in the gaps of the scan."""

    writes: ClassVar[bool] = False
    returns_values: ClassVar[bool] = True
    numbers: Annotated[list[ParameterNumber], Meta(max_length=40)] = field(default_factory=list)
    urgent: bool = True


class WriteParameter(UnitAction, frozen=True, tag="write_parameter"):
    """86h, read back by 85h. The app has checked range, access and confirmation."""

    number: ParameterNumber
    raw: FourBytes


class ChangeBaud(BusAction, frozen=True, tag="change_baud"):
    """Write #18 to every unit of the bus, follow, read all back; go back if one does not respond."""

    baud: BaudRate


class ScanBus(BusAction, frozen=True, tag="scan_bus"):
    """Find which addresses respond, in the gaps of the scan, at the present baud rate."""

    writes: ClassVar[bool] = False
    first: UnitId = 1
    last: UnitId = 255


class ReadTrace(BusAction, frozen=True, tag="read_trace"):
    """Return the kept frames (an hour at most) from ``since`` on, oldest first, as the result's ``frames``:
    at most ``limit`` of them, so a longer span is requested in parts, from the last frame's time. Sends
    nothing.
    """

    writes: ClassVar[bool] = False
    most_frames: ClassVar[int] = MAX_FRAMES
    since: Stamp
    limit: Annotated[int, Meta(ge=1, le=MAX_FRAMES)] = MAX_FRAMES


WireAction = (
    SetSpeed
    | ExecuteSpeed
    | ExecuteAll
    | SetLine
    | WriteOutput
    | WriteAnalogOutput
    | ReadParameters
    | WriteParameter
    | ChangeBaud
    | ScanBus
)
Action = WireAction | ReadTrace
