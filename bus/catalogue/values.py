"""Integers on the wire ⇄ the numbers that people use, and the bits of the status bytes ST2 and ST1.

Exact decimal arithmetic, no floats except for volts. Texts have a point and no grouping; the caller localizes
them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import ROUND_HALF_UP, Decimal
from functools import lru_cache

from bus.catalogue.parameters import PARAMETERS, IllegalValue, Parameter, Scale
from bus.errors import CallerError
from bus.messages import Message, number, term

OUTPUT_NUMBERS = range(1, 7)


@dataclass(frozen=True, slots=True)
class StatusBits:
    """The bits of ST2 and ST1 by name. ``outputs[0]`` is auxiliary output 1."""

    at_speed: bool
    remote: bool
    outputs: tuple[bool, bool, bool, bool, bool, bool]
    run: bool
    estop_active: bool
    """Whether an emergency stop is active, whichever level means that in this dialect."""
    preset: bool
    reverse: bool
    up: bool
    down: bool
    follower: bool

    @property
    def inputs(self) -> dict[str, bool]:
        """The inputs of ST1 by the names that the API gives them."""
        return {
            "run": self.run,
            "estop": self.estop_active,
            "preset": self.preset,
            "reverse": self.reverse,
            "up": self.up,
            "down": self.down,
            "slave": self.follower,
        }


@lru_cache(maxsize=4096)
def status_bits(outputs: int, inputs: int, estop_healthy: int = 1) -> StatusBits:
    """Return the bits of ``outputs`` (ST2) and ``inputs`` (ST1); ``estop_healthy`` is the dialect's level of
    a healthy chain."""
    one, two, three, four, five, six, remote, at_speed = (_bit(outputs, position) for position in range(8))
    run, estop, preset, reverse, up, down, follower = (_bit(inputs, position) for position in range(7))
    auxiliary = (one, two, three, four, five, six)
    estop_active = estop != bool(estop_healthy)
    return StatusBits(at_speed, remote, auxiliary, run, estop_active, preset, reverse, up, down, follower)


def output_is_on(outputs: int, number: int) -> bool:
    """Return whether auxiliary output ``number`` (1-6) is on in ST2."""
    return _bit(outputs, number - 1)


def _bit(byte: int, position: int) -> bool:
    return bool(byte >> position & 1)


RATIO_DECIMALS = 4
_FOLLOWER_MODES = (1, 2)
"""The values of #8 of a follower and of an inverse follower (manual, 4.0)."""
MAX_DECIMALS = 4
"""The largest value of #3 (manual, 4.0), and the decimals of a ratio."""
HIGHEST_ATD = 255
HIGHEST_SPEED = 99_999
_FULL_VOLTS = 10
_NUMBER = re.compile(r"([0-9]{1,9})(?:[.,]([0-9]{1,9}))?")
_SCALE_UNITS = {Scale.TENTHS: "s", Scale.BAUD: "baud"}


def plausible_speed(raw: int | None) -> int | None:
    """Return a speed, or ratio, as sent by 81h, or None if it is beyond the range of the manual
    (0-1869Fh)."""
    return raw if raw is not None and raw <= HIGHEST_SPEED else None


@lru_cache(1024)
def plausible_parameter(number: int, raw: int | None) -> int | None:
    """Return a parameter as sent, or None outside of its printed range (manual, 4.0)."""
    known = PARAMETERS.get(number)
    return raw if raw is not None and known and known.minimum <= raw <= known.maximum else None


def is_follower(mode: int | None) -> bool:
    """Return whether #8 (``mode``) makes a unit follow a master by a ratio; False if it is not known."""
    return mode in _FOLLOWER_MODES


def speed_text(raw: int, decimals: int) -> str:
    """Return ``raw`` display units with ``decimals`` (#3) places: 12345 with 1 is "1234.5".

    The text is marked as raw if ``decimals`` exceeds :data:`MAX_DECIMALS`.
    """
    if decimals > MAX_DECIMALS:
        return str(bare(raw))
    integer_part, part = divmod(raw, 10**decimals)
    return f"{integer_part}.{part:0{decimals}d}" if decimals else str(integer_part)


def speed_raw(text: str, decimals: int) -> int:
    """Return the raw integer for a typed number; point and comma both separate decimals.

    More places than ``decimals`` are refused even if they are zeros: in "1.000" for a display with one
    decimal the point was most likely meant to group thousands. Raise CallerError, IllegalValue for a number
    that has a nearest one.
    """
    if decimals > MAX_DECIMALS:
        raise CallerError(Message("decimals_too_many"))
    text = text.strip()
    found = _NUMBER.fullmatch(text)
    if found is None:
        raise _no_number(text, number(speed_text(1234, decimals)))
    integer_part, part = found[1], found[2] or ""
    if len(part) > decimals:
        code = "value_has_decimals" if decimals else "value_takes_no_decimals"
        reason = Message.of(code, number=text, count=len(part), allowed=decimals)
        nearest = (Decimal(f"{integer_part}.{part}") * 10**decimals).quantize(Decimal(1), ROUND_HALF_UP)
        raise IllegalValue(reason, int(nearest))
    return int(integer_part + part.ljust(decimals, "0"))


def speed_message(raw: int, decimals: int | None) -> Message:
    """Return ``raw`` display units for people, marked as raw while the ``decimals`` are unknown (None)."""
    if decimals is None or decimals > MAX_DECIMALS:
        return bare(raw)
    return number(speed_text(raw, decimals))


def bare(raw: int) -> Message:
    """Return an integer of the wire as a message that marks it as raw."""
    return Message.of("raw_value", raw=raw)


def ratio_text(raw: int) -> str:
    """Return a ratio as people read it: 10000 is "1.0000"."""
    return speed_text(raw, RATIO_DECIMALS)


def ratio_raw(text: str) -> int:
    """Return the raw ratio for a typed number of up to four decimals. Raise CallerError for any other."""
    return speed_raw(text, RATIO_DECIMALS)


def analog_input_value(atd: int, low: int, high: int) -> float:
    """Return the engineering value of ATD 0-255, ``low`` being #22 and ``high`` #23."""
    return low + (high - low) * atd / HIGHEST_ATD


def analog_output_volts(raw: int, low: int, high: int) -> float:
    """Return the volts for the value of 88h; ``low`` is #29, ``high`` #30. Raise CallerError if they are
    equal."""
    if low == high:
        raise CallerError(Message("analog_limits_equal"))
    return _FULL_VOLTS * (raw - low) / (high - low)


def rpm(raw: int, max_rpm: int, max_display: int) -> float:
    """Return the motor speed of a displayed one: ``max_rpm`` #1, ``max_display`` #2. Raise CallerError if #2
    is 0."""
    if max_display == 0:
        raise CallerError(Message("maximum_speed_zero"))
    return raw * max_rpm / max_display


def parameter_unit(parameter: Parameter) -> str:
    """Return the unit to write after ``parameter_text``: "s", "rpm", "baud", or "" for the drive's own
    unit."""
    return _SCALE_UNITS.get(parameter.scale, parameter.unit)


def parameter_text(parameter: Parameter, raw: int, decimals: int | None, *, follower: bool = False) -> str:
    """Return :func:`parameter_message` in English."""
    return str(parameter_message(parameter, raw, decimals, follower=follower))


def parameter_message(
    parameter: Parameter, raw: int, decimals: int | None, *, follower: bool = False
) -> Message:
    """Return the value of a parameter for people: the name of a choice if known, else the number in its
    scale.

    ``decimals`` is #3 of the unit, None while it is not known: a speed is then marked as raw. ``follower``:
    #8 is 1 or 2, so presets and jumps are ratios. A secret is not shown, and a value outside of the printed
    range is marked as such.
    """
    if parameter.secret:
        return Message("value_hidden")
    if plausible_parameter(parameter.number, raw) is None:
        return Message.of("value_implausible", raw=raw)
    if raw in parameter.choices:
        return term(parameter.choices[raw])
    if parameter.scale is Scale.BAUD:
        return number(str(raw * 100))
    return speed_message(raw, parameter_decimals(parameter, decimals, follower))


def parameter_raw(parameter: Parameter, text: str, decimals: int | None, *, follower: bool = False) -> int:
    """Return the raw integer for what a person typed, a number or the name of a choice.

    The range is not checked here. Raise CallerError for anything else, and for a speed while the unit's
    decimals (#3) are not known.
    """
    for raw, name in parameter.choices.items():
        if text.strip().casefold() == name.casefold():
            return raw
    typed = text.strip()
    if parameter.secret and not (typed.isascii() and typed.isdecimal()):
        # An ordinary refusal would repeat what was typed.
        raise CallerError(Message("not_a_number_plain"))
    places = parameter_decimals(parameter, decimals, follower)
    if places is None:
        raise CallerError(Message("decimals_not_read"))
    raw = speed_raw(text, places)
    if parameter.scale is not Scale.BAUD:
        return raw
    if raw % 100:
        raise CallerError(Message.of("not_a_baud_rate", raw=raw))
    return raw // 100


def parameter_decimals(parameter: Parameter, decimals: int | None, follower: bool = False) -> int | None:
    """Return the decimals of a raw value, None while those of a speed are not known. The arguments are those
    of `parameter_message`."""
    match parameter.scale:
        case Scale.RATIO:
            return RATIO_DECIMALS
        case Scale.SPEED_OR_RATIO:
            return RATIO_DECIMALS if follower else decimals
        case Scale.SPEED:
            return decimals
        case Scale.TENTHS:
            return 1
        case _:
            return 0


def _no_number(text: str, example: Message) -> CallerError:
    if not text:
        return CallerError(Message.of("number_missing", example=example))
    if _NUMBER.fullmatch(text.replace("\N{MINUS SIGN}", "-").removeprefix("-")):
        return IllegalValue(Message.of("number_below_zero", number=text), 0)
    return CallerError(Message.of("not_a_number", text=text, example=example))
