"""One DIGIMAX IV as pure state, and the effect of a request on it: no clock, no I/O.

Its motor is in ``bus.simulator.plant``. The rules, with their places in the manual:

* reads get a response in every mode, writes only in REMOTE, else NAK 80h (1.0, and every write command);
* nothing on the link leads out of LOCAL or KEYLOCK (4.0 ***), because that would be a write;
* a speed above #2, or a ratio outside #38-#31 in a follower, is NAK 81h;
* #8 while RUN is on, any set-up while RUN is on and #16 is 0, and #17 always, are NAK 83h: the parameter
  is there and can be read, so no value is legal now, and 82h would mean that the number does not exist;
* 88h needs #28 = 2, else NAK 87h, and a value from #29 to #30, else NAK 88h;
* an unknown command, or one with the wrong amount of data, is NAK 89h.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

from bus.catalogue import parameters as numbers
from bus.catalogue.parameters import PARAMETERS, nearest_legal
from bus.errors import UnitErrorCode
from bus.settings import Dialect
from bus.wire.commands import (
    Ack,
    ExecuteSpeedRequest,
    IllegalRequest,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    StatusReply,
    WriteAnalogOutputRequest,
    WriteOutputRequest,
    WriteParameterRequest,
    parse_request,
)


class Mode(IntEnum):
    """The control mode #19, in the order of its title."""

    LOCAL = 0
    REMOTE = 1
    KEYLOCK = 2


FACTORY: Mapping[int, int] = {
    **dict.fromkeys(PARAMETERS, 0),
    numbers.MAX_RPM: 1750,
    numbers.MAX_DISPLAY: 2000,
    numbers.DECIMALS: 1,
    numbers.BASE_RATIO: 10000,
    numbers.ENCODER_PPR: 60,
    numbers.ACCELERATION: 100,
    numbers.DECELERATION: 100,
    numbers.PRESET_SPEED: 200,
    numbers.JUMP_UP: 5,
    numbers.JUMP_DOWN: 5,
    numbers.AT_SPEED_WINDOW: 10,
    numbers.JUMP_MODE: 1,
    numbers.DISPLAY_RATE: 10,
    numbers.SETUP_DURING_RUN: 1,
    numbers.OWN_ADDRESS: 1,
    numbers.BAUD_RATE: 96,
    numbers.CONTROL_MODE: Mode.REMOTE,
    numbers.ANALOG_IN_HIGH: 255,
    numbers.ANALOG_IN_RATE: 10,
    numbers.ANALOG_OUT_SOURCE: 2,
    numbers.ANALOG_OUT_HIGH: 2000,
    numbers.MAX_RATIO: 20000,
    numbers.RATIO_SETPOINT: 10000,
    numbers.MIN_RATIO: 5000,
    numbers.DEBOUNCE: 20,
}
"""The values of a new unit: address 1 at 9600 baud; in REMOTE, so that a host can be tried on it."""

_WIDTHS = {"UCHR": 1, "UINT": 2, "ULNG": 4}


class Memory(dict[int, int]):
    """The forty parameters of a unit, as delivered except for ``changed``.

    This is a dict and not a wrapper around one: the physics of 255 units looks up a hundred thousand a
    second.
    """

    def __init__(self, changed: Mapping[int, int] | None = None) -> None:
        super().__init__(FACTORY)
        self.update(changed or {})

    def takes(self, number: int, raw: int) -> bool:
        """Return whether ``raw`` is a value that the parameter can hold, by its printed range and its
        kind."""
        if nearest_legal(PARAMETERS[number], raw) != raw:
            return False
        if number == numbers.SPEED_SETPOINT:
            return raw <= self[numbers.MAX_DISPLAY]
        if number == numbers.RATIO_SETPOINT:
            return self[numbers.MIN_RATIO] <= raw <= self[numbers.MAX_RATIO]
        return True


def width_by_type(number: int) -> int:
    """Return the bytes of the parameter's data type: UCHR 1, UINT 2, ULNG 4."""
    return _WIDTHS[PARAMETERS[number].type]


@dataclass(frozen=True, slots=True)
class Traits:
    """The points that the manual leaves open, as one unit decides them."""

    dialect: Dialect = field(default_factory=Dialect)
    last_parameter: int = 40
    """The last parameter that the unit has; 20 with old firmware."""
    responds_with_written_value: bool = False
    baud_changes: Literal["at once", "at power-up"] = "at power-up"
    turnaround_s: float = 0.0
    turnaround_jitter: float = 0.2


ORDINARY = Traits()


@dataclass(slots=True)
class Inputs:
    """The contacts at the terminals. ``estop`` is True while an emergency stop is pressed."""

    run: bool = True
    estop: bool = False
    preset: bool = False
    reverse: bool = False
    up: bool = False
    down: bool = False


@dataclass(slots=True)
class Measured:
    """The shaft speed and the analog input as the unit measures them; the section's physics writes it.

    ``following`` is the speed that the master's pulses command to a follower, ``ratio`` the present ratio.
    """

    actual: int = 0
    analog: int = 0
    following: int = 0
    ratio: int = 0


@dataclass
class Unit:
    """The state behind one address. Only its section changes it over time."""

    memory: Memory = field(default_factory=Memory)
    traits: Traits = ORDINARY
    inputs: Inputs = field(default_factory=Inputs)
    measured: Measured = field(default_factory=Measured)
    random: random.Random = field(default_factory=lambda: random.Random(0))

    def __post_init__(self) -> None:
        self.power_up()

    def power_up(self) -> None:
        """Switch the unit off and on: parameters stay, staged speed and outputs are cleared, #18 takes
        effect."""
        self.baud = self.memory[numbers.BAUD_RATE] * 100
        self.outputs = [False] * 6
        self.analog_output = self.memory[numbers.ANALOG_OUT_LOW]
        self.entered = self.setpoint

    def has(self, number: int) -> bool:
        """Return whether the unit's firmware knows the parameter."""
        return 1 <= number <= self.traits.last_parameter

    @property
    def address(self) -> int:
        return self.memory[numbers.OWN_ADDRESS]

    @property
    def mode(self) -> Mode:
        return Mode(self.memory[numbers.CONTROL_MODE])

    @property
    def follows(self) -> bool:
        """Whether #8 makes the unit a slave or an inverse slave."""
        return self.memory[numbers.FOLLOWER_MODE] != 0

    @property
    def setpoint(self) -> int:
        """The executed speed, or ratio in a follower."""
        return self.memory[numbers.RATIO_SETPOINT if self.follows else numbers.SPEED_SETPOINT]

    @setpoint.setter
    def setpoint(self, raw: int) -> None:
        self.memory[numbers.RATIO_SETPOINT if self.follows else numbers.SPEED_SETPOINT] = raw

    @property
    def commanded(self) -> int:
        """The commanded speed (ratio in a follower): preset before jump before setpoint."""
        if self.inputs.preset:
            return self.memory[numbers.PRESET_SPEED]
        if self.memory[numbers.JUMP_MODE] == 1:
            up = self.memory[numbers.JUMP_UP] * self.inputs.up
            down = self.memory[numbers.JUMP_DOWN] * self.inputs.down
            return min(max(self.setpoint + up - down, 0), self.highest)
        return self.setpoint

    @property
    def highest(self) -> int:
        """The highest value that 82h and 84h take: #2, or #31 in a follower."""
        return self.memory[numbers.MAX_RATIO if self.follows else numbers.MAX_DISPLAY]

    @property
    def lowest(self) -> int:
        """The lowest value that 82h and 84h take: 0, or #38 in a follower."""
        return self.memory[numbers.MIN_RATIO] if self.follows else 0

    @property
    def running(self) -> bool:
        """Whether the drive turns the motor."""
        return self.inputs.run and not self.inputs.estop

    @property
    def at_speed(self) -> bool:
        """Whether the unit runs within #12 of its commanded speed."""
        target = self.measured.following if self.follows else self.commanded
        return self.running and abs(self.measured.actual - target) <= self.memory[numbers.AT_SPEED_WINDOW]

    def turnaround(self) -> float:
        """Return the seconds until the next response begins, drawn from the unit's seeded randomness."""
        jitter = self.traits.turnaround_jitter
        return self.traits.turnaround_s * self.random.uniform(1 - jitter, 1 + jitter)

    def status(self, uid: int) -> StatusReply:
        """Return the response to 81h under the requested address (manual, READ SPEED AND STATUS)."""
        commanded, actual = self.commanded, self.measured.actual
        if self.follows and self.traits.dialect.follower_speed == "speed":
            commanded = self.measured.following
        elif self.follows:
            actual = self.measured.ratio
        st2 = (*self.outputs, self.mode is Mode.REMOTE, self.at_speed)
        inputs = self.inputs
        estop = self.traits.dialect.estop_healthy ^ inputs.estop
        st1 = (inputs.run, estop, inputs.preset, inputs.reverse, inputs.up, inputs.down, self.follows)
        return StatusReply(uid, commanded, actual, self.measured.analog, _byte_of(st2), _byte_of(st1))


def _byte_of(bits: Sequence[bool | int]) -> int:
    """Return the byte with these bits, the lowest first."""
    return sum(bool(on) << place for place, on in enumerate(bits))


ALL_UNITS = 0
"""The UID of an 83h to every unit, which has no response."""

Rejection = UnitErrorCode | None


@dataclass(frozen=True, slots=True)
class Turn:
    """The effect of a request. ``acted``: a write was carried out; ``reply`` None: no response."""

    reply: Reply | None
    acted: bool


def respond(unit: Unit, body: bytes) -> Turn:
    """Carry out one request that reached ``unit``; ``body``: its bytes between STX and DLE ETX."""
    try:
        request = parse_request(body, unit.traits.dialect)
    except IllegalRequest as error:
        return Turn(_refuse_illegal(unit, error), acted=False)
    if request.unit == ALL_UNITS:
        acted = isinstance(request, ExecuteSpeedRequest) and _write(unit, request) is None
        return Turn(None, acted)
    match request:
        case ReadStatusRequest():
            return Turn(unit.status(request.unit), acted=False)
        case ReadParameterRequest():
            return Turn(_read(unit, request), acted=False)
    refusal = _write(unit, request)
    if refusal is not None:
        return Turn(Nak(request.unit, refusal), acted=False)
    written = b""
    if isinstance(request, WriteParameterRequest) and unit.traits.responds_with_written_value:
        written = request.raw.to_bytes(4, "big")
    return Turn(Ack(request.unit, written), acted=True)


def _refuse_illegal(unit: Unit, error: IllegalRequest) -> Reply | None:
    """Refuse a malformed request in every mode, and a malformed value if a write could count."""
    if error.unit == ALL_UNITS:
        return None
    if error.code == UnitErrorCode.ILLEGAL_OUTPUT_VALUE and unit.mode is not Mode.REMOTE:
        return Nak(error.unit, UnitErrorCode.NOT_REMOTE)
    return Nak(error.unit, error.code)


def _read(unit: Unit, request: ReadParameterRequest) -> Reply:
    if not unit.has(request.number):
        return Nak(request.unit, UnitErrorCode.ILLEGAL_PARAMETER_NUMBER)
    width = unit.traits.dialect.parameter_reply_bytes or width_by_type(request.number)
    return ParameterReply(request.unit, unit.memory[request.number] & (1 << 8 * width) - 1, width)


def _write(unit: Unit, request: Request) -> Rejection:
    if unit.mode is not Mode.REMOTE:
        return UnitErrorCode.NOT_REMOTE
    match request:
        case StageSpeedRequest(raw=raw):
            return _enter(unit, raw)
        case ExecuteSpeedRequest():
            unit.setpoint = unit.entered
            return None
        case SetAndExecuteSpeedRequest(raw=raw):
            refusal = _enter(unit, raw)
            if refusal is None:
                unit.setpoint = raw
            return refusal
        case WriteParameterRequest(number=number, raw=raw):
            return _write_parameter(unit, number, raw)
        case WriteOutputRequest(output=output, on=on):
            if not 1 <= output <= len(unit.outputs):
                return UnitErrorCode.ILLEGAL_OUTPUT_NUMBER
            unit.outputs[output - 1] = on
            return None
        case WriteAnalogOutputRequest(raw=raw):
            return _write_analog(unit, raw)
    return UnitErrorCode.ILLEGAL_COMMAND


def _enter(unit: Unit, raw: int) -> Rejection:
    if not unit.lowest <= raw <= unit.highest:
        return UnitErrorCode.ILLEGAL_SPEED
    unit.entered = raw
    return None


def _write_parameter(unit: Unit, number: int, raw: int) -> Rejection:
    if not unit.has(number):
        return UnitErrorCode.ILLEGAL_PARAMETER_NUMBER
    if number == numbers.OWN_ADDRESS or _locked_by_run(unit, number) or not unit.memory.takes(number, raw):
        return UnitErrorCode.ILLEGAL_PARAMETER_VALUE
    unit.memory[number] = raw
    if number == numbers.FOLLOWER_MODE:
        unit.entered = unit.setpoint
    if number == numbers.BAUD_RATE and unit.traits.baud_changes == "at once":
        unit.baud = raw * 100
    return None


def _locked_by_run(unit: Unit, number: int) -> bool:
    if not unit.inputs.run or number in (numbers.SPEED_SETPOINT, numbers.RATIO_SETPOINT):
        return False
    return number == numbers.FOLLOWER_MODE or not unit.memory[numbers.SETUP_DURING_RUN]


def _write_analog(unit: Unit, raw: int) -> Rejection:
    if unit.memory[numbers.ANALOG_OUT_SOURCE] != 2:
        return UnitErrorCode.ANALOG_OUTPUT_NOT_COMMANDED_BY_LINK
    if not unit.memory[numbers.ANALOG_OUT_LOW] <= raw <= unit.memory[numbers.ANALOG_OUT_HIGH]:
        return UnitErrorCode.ILLEGAL_ANALOG_VALUE
    unit.analog_output = raw
    return None
