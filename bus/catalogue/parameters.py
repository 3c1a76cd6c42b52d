"""The 40 parameters of a DIGIMAX IV as a table, and their numbers by name (manual, section 4.0).

Number, name, type and range are as printed, except that #31 ends at 1387Fh = 79999. What the list leaves out
carries its mark of evidence (A stated in the manual, B stated for the sibling DFS-1 and consistent, C
inferred, U unknown); an undocumented choice is not named and is shown by its number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Literal

from bus.errors import CallerError
from bus.messages import PARAMETER_NAMES, Message

MAX_RPM = 1
MAX_DISPLAY = 2
DECIMALS = 3
BASE_RATIO = 4
ENCODER_PPR = 5
ACCELERATION = 6
DECELERATION = 7
FOLLOWER_MODE = 8
PRESET_SPEED = 9
JUMP_UP = 10
JUMP_DOWN = 11
AT_SPEED_WINDOW = 12
JUMP_MODE = 13
FREEZE_MODE = 14
DISPLAY_RATE = 15
SETUP_DURING_RUN = 16
OWN_ADDRESS = 17
"""The number of a unit's own address. Only the unit's panel changes it (manual, 4.0), so its value is known
beforehand. If it reads as another address, another unit responds there; the address in a response is no
evidence, because it repeats that of the request."""
BAUD_RATE = 18
CONTROL_MODE = 19
SPEED_SETPOINT = 20
PASSWORD = 21
ANALOG_IN_LOW = 22
ANALOG_IN_HIGH = 23
ANALOG_IN_MODE = 24
ANALOG_IN_RATE = 25
ANALOG_IN_TRIM = 26
PROTOCOL = 27
ANALOG_OUT_SOURCE = 28
ANALOG_OUT_LOW = 29
ANALOG_OUT_HIGH = 30
MAX_RATIO = 31
PRESET_INPUT_MODE = 32
REVERSE_INPUT_MODE = 33
UP_INPUT_MODE = 34
DOWN_INPUT_MODE = 35
INSTALLED_OPTION = 36
RATIO_SETPOINT = 37
MIN_RATIO = 38
DEBOUNCE = 39
AT_SPEED_SOURCE = 40
SETPOINTS = (SPEED_SETPOINT, RATIO_SETPOINT)
"""The parameters in which a unit keeps what a host or a panel commands; the others change by its set-up
alone."""


DataType = Literal["UCHR", "UINT", "ULNG"]
Evidence = Literal["A", "B", "C", "U"]


class Scale(StrEnum):
    """The conversion of the integer on the wire to the number that people use."""

    PLAIN = "plain"
    SPEED = "speed"
    """The integer is display units with #3 decimals."""
    SPEED_OR_RATIO = "speed or ratio"
    """Display units in a master; in a follower a ratio with four decimals."""
    RATIO = "ratio"
    """The integer has four implied decimals: 10000 is 1.0000."""
    TENTHS = "tenths of a second"
    BAUD = "hundreds of baud"


@dataclass(frozen=True, slots=True)
class Parameter:
    """A row of the table. Ranges are raw integers, both ends included."""

    number: int
    name: str
    type: DataType
    minimum: int
    maximum: int
    evidence: Evidence
    """The mark for meaning and scale; number, name, type and range are always A."""
    group: str
    meaning: str
    scale: Scale = Scale.PLAIN
    unit: str = ""
    """Unit of the engineering value if it is the same for every drive."""
    choices: Mapping[int, str] = field(default_factory=dict, hash=False)
    allowed: frozenset[int] | None = None
    """The only legal values if the range has holes."""
    never_writable: bool = False
    dangerous: str = ""
    """The harm that a write can do to the link; empty if it can do none."""
    harmless: frozenset[int] = frozenset()
    """Values of a dangerous parameter that cannot have the effect in ``dangerous``."""
    secret: bool = False
    not_while_running: bool = False
    """Whether the unit refuses a change during RUN."""


class IllegalValue(CallerError):
    """Raised for a value that a parameter cannot take; ``nearest`` is the closest value that it can."""

    def __init__(self, message: Message, nearest: int) -> None:
        super().__init__(message)
        self.nearest = nearest


def danger_of_writing(parameter: Parameter, raw: int) -> str:
    """Return what writing ``raw`` can do to the link; empty if it cannot harm the link."""
    return "" if raw in parameter.harmless else parameter.dangerous


def check_writable_value(parameter: Parameter, raw: int) -> None:
    """Check a value before it is written. Raise CallerError for a parameter that is never written,
    IllegalValue for a value that the parameter cannot take."""
    if parameter.never_writable:
        raise CallerError(Message.of("parameter_not_by_link", number=parameter.number, called=parameter.name))
    nearest = nearest_legal(parameter, raw)
    if nearest != raw:
        raise IllegalValue(_refusal(parameter, raw, nearest), nearest)


def _refusal(parameter: Parameter, raw: int, nearest: int) -> Message:
    legal = _legal_values(parameter)
    if parameter.secret:
        # The message is logged, and what was typed may be the secret with one digit too many.
        return Message.of("parameter_takes", number=parameter.number, called=parameter.name, values=legal)
    return Message.of(
        "parameter_cannot_be",
        number=parameter.number,
        called=parameter.name,
        raw=raw,
        values=legal,
        nearest=nearest,
    )


def nearest_legal(parameter: Parameter, raw: int) -> int:
    """Return the value closest to ``raw`` that the parameter takes, the smaller of two equally close ones."""
    if parameter.allowed is not None:
        return min(sorted(parameter.allowed), key=lambda legal: abs(legal - raw))
    return min(max(raw, parameter.minimum), parameter.maximum)


def _legal_values(parameter: Parameter) -> Message:
    if parameter.allowed is None:
        return Message.of("value_range", lowest=parameter.minimum, highest=parameter.maximum)
    *others, last = sorted(parameter.allowed)
    return Message.of("one_of_values", others=list(others), last=last)


SPEED, MODES, RATIO, RAMPS = "Speed and display", "Mode", "Ratio", "Ramps"
STEPS, INPUTS = "Presets and jumps", "Inputs"
ANALOG_IN, ANALOG_OUT = "Analog input", "Analog output"
LINK, OPERATOR = "Link", "Operator"

# fmt: off
_ROWS = (
    Parameter(1, "Maximum Motor Speed", "UINT", 0, 65535, "C", SPEED,
              "Motor speed at full scale.",
              unit="rpm"),
    Parameter(2, "Maximum Display Value", "ULNG", 0, 99999, "C", SPEED,
              "The number displayed at the maximum motor speed (parameter 1).",
              scale=Scale.SPEED),
    Parameter(3, "Decimal Location", "UCHR", 0, 4, "C", SPEED,
              "Number of decimal places of every displayed speed."),
    Parameter(4, "Base Ratio", "ULNG", 0, 99999, "B", RATIO,
              "Base ratio of a follower to its master.",
              scale=Scale.RATIO),
    Parameter(5, "Encoder PPR", "UINT", 0, 5000, "A", SPEED,
              "Encoder pulses per revolution.",
              unit="pulses/rev"),
    Parameter(6, "Acceleration Ramp Rate", "UINT", 0, 9999, "A", RAMPS,
              "Time to accelerate over the full speed range.",
              scale=Scale.TENTHS),
    Parameter(7, "Deceleration Ramp Rate", "UINT", 0, 9999, "A", RAMPS,
              "Time to decelerate over the full speed range.",
              scale=Scale.TENTHS),
    Parameter(8, "Master/Slave/Inverse Mode", "UCHR", 0, 2, "B", MODES,
              "Master with its own speed, or follower of another unit by a ratio.",
              choices={0: "Master", 1: "Follower", 2: "Inverse follower"}, not_while_running=True),
    Parameter(9, "Preset Speed", "ULNG", 0, 99999, "C", STEPS,
              "Speed while the Preset input is on.",
              scale=Scale.SPEED_OR_RATIO),
    Parameter(10, "Jump Up Delta", "ULNG", 0, 99999, "C", STEPS,
              "Step of the Up input.",
              scale=Scale.SPEED_OR_RATIO),
    Parameter(11, "Jump Down Delta", "ULNG", 0, 99999, "C", STEPS,
              "Step of the Down input.",
              scale=Scale.SPEED_OR_RATIO),
    Parameter(12, "Up to Speed Tolerance", "UCHR", 0, 255, "C", SPEED,
              "The unit is at speed while the actual speed is this close to the commanded speed.",
              scale=Scale.SPEED),
    Parameter(13, "MOP/Jump Mode", "UCHR", 0, 1, "U", STEPS,
              "Up and Down as a motor potentiometer or as jumps; which number is which is not known."),
    Parameter(14, "Freeze/Float Mode", "UCHR", 0, 1, "U", MODES,
              "Not explained in the manual."),
    Parameter(15, "Display Sample Rate", "UCHR", 1, 255, "U", SPEED,
              "How often the unit refreshes its own display; the unit of time is not known."),
    Parameter(16, "Allow Setup During Run", "UCHR", 0, 1, "C", OPERATOR,
              "Allows setup parameters to be changed while the unit runs.",
              choices={0: "No", 1: "Yes"}),
    Parameter(17, "Unit ID Number", "UCHR", 1, 255, "A", LINK,
              "The unit's address on the bus; set at the unit's keypad only.",
              never_writable=True),
    Parameter(18, "Baud Rate", "UCHR", 3, 96, "A", LINK,
              "Baud rate in hundreds.",
              dangerous="The unit responds only at the new baud rate: no response until the host follows",
              scale=Scale.BAUD, allowed=frozenset({3, 6, 12, 24, 48, 96})),
    Parameter(19, "Local/Remote/Keylock", "UCHR", 0, 2, "C", LINK,
              "Source of the unit's commands. The bus cannot leave Local.",
              dangerous="The unit will reject every write, also an undo of this one, "
                        "until it is set to REMOTE at its keypad",
              choices={0: "Local", 1: "Remote", 2: "Keylock"}, harmless=frozenset({1})),
    Parameter(20, "Speed Setpoint", "ULNG", 0, 99999, "C", SPEED,
              "Speed setpoint.",
              scale=Scale.SPEED),
    Parameter(21, "Operator Password", "ULNG", 0, 99999, "C", OPERATOR,
              "Password of the unit's keypad.",
              secret=True),
    Parameter(22, "A to D Low Engr Units", "UINT", 0, 999, "C", ANALOG_IN,
              "Value shown when the analog input reads 0."),
    Parameter(23, "A to D High Engr Units", "UINT", 0, 999, "C", ANALOG_IN,
              "Value shown when the analog input reads 255."),
    Parameter(24, "A to D Display Mode", "UCHR", 0, 1, "U", ANALOG_IN,
              "Not explained in the manual."),
    Parameter(25, "A to D Sample Rate", "UCHR", 1, 255, "U", ANALOG_IN,
              "How often the analog input is read; the unit of time is not known."),
    Parameter(26, "A to D Trim Enable", "UCHR", 0, 1, "U", ANALOG_IN,
              "Trim by the analog input.",
              choices={0: "Off", 1: "On"}),
    Parameter(27, "Communications Protocol", "UCHR", 0, 3, "U", LINK,
              "Protocol of the bus; which number is which is not known.",
              dangerous="The manual does not explain its values; a wrong one ends communication"),
    Parameter(28, "D to A Source", "UCHR", 0, 3, "A", ANALOG_OUT,
              "Source of the analog output; the host can set it only while this is 2.",
              choices={2: "RS-422 bus"}),
    Parameter(29, "D to A Low Engineering Units", "ULNG", 0, 99999, "A", ANALOG_OUT,
              "Value for 0 V at the analog output."),
    Parameter(30, "D to A High Engineering Units", "ULNG", 0, 99999, "A", ANALOG_OUT,
              "Value for 10 V at the analog output."),
    Parameter(31, "Maximum Ratio", "ULNG", 0, 79999, "B", RATIO,
              "Highest ratio that a follower accepts.",
              scale=Scale.RATIO),
    Parameter(32, "Preset Input Mode", "UCHR", 0, 2, "U", INPUTS,
              "Not explained in the manual."),
    Parameter(33, "Reverse Input Mode", "UCHR", 0, 2, "U", INPUTS,
              "Not explained in the manual."),
    Parameter(34, "Up Input Mode", "UCHR", 0, 1, "U", INPUTS,
              "Not explained in the manual."),
    Parameter(35, "Down Input Mode", "UCHR", 0, 1, "U", INPUTS,
              "Not explained in the manual."),
    Parameter(36, "Installed Option Enable", "UCHR", 0, 2, "U", OPERATOR,
              "Not explained in the manual."),
    Parameter(37, "Command Ratio Setpoint", "ULNG", 0, 99999, "B", RATIO,
              "Ratio setpoint of a follower.",
              scale=Scale.RATIO),
    Parameter(38, "Minimum Ratio", "ULNG", 0, 99999, "B", RATIO,
              "Lowest ratio that a follower accepts.",
              scale=Scale.RATIO),
    Parameter(39, "Debounce Value", "UCHR", 0, 255, "U", INPUTS,
              "How long an input must be on to be accepted; the unit of time is not known."),
    Parameter(40, "At Speed Source", "UCHR", 0, 1, "U", MODES,
              "Not explained in the manual."),
)
# fmt: on

PARAMETERS: Mapping[int, Parameter] = MappingProxyType({row.number: row for row in _ROWS})
"""The parameters by number, 1 to 40."""
PARAMETER_NAMES.update({row.number: row.name for row in _ROWS})
NEEDED_TO_SHOW = (
    *(MAX_RPM, MAX_DISPLAY, DECIMALS, FOLLOWER_MODE, AT_SPEED_WINDOW),
    *(ANALOG_IN_LOW, ANALOG_IN_HIGH),
    *(ANALOG_OUT_SOURCE, ANALOG_OUT_LOW, ANALOG_OUT_HIGH),
)
"""The parameters without which a reading cannot be shown right."""
NEEDED_TO_JUDGE = (MAX_RATIO, MIN_RATIO)
"""A follower's limits, without which a ratio cannot be checked before it is sent."""
