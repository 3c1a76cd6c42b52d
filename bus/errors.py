"""Errors by whose fault, and the errors of a unit in words.

Each message states what happened and what to do.
"""

from __future__ import annotations

from enum import IntEnum

from bus.messages import Message


class LinesideError(Exception):
    """The base of every error that this project raises on purpose; ``str`` is ``message`` in English."""

    def __init__(self, message: Message) -> None:
        super().__init__(str(message))
        self.message = message


class CallerError(LinesideError):
    """Raised for a request that cannot be carried out; nothing was sent."""


class WireError(LinesideError):
    """Raised when the port, the cable or a response failed; the unit may have acted."""


class UnitErrorCode(IntEnum):
    """The error byte [ERR] of a NAK (manual, the command pages)."""

    NOT_REMOTE = 0x80
    ILLEGAL_SPEED = 0x81
    ILLEGAL_PARAMETER_NUMBER = 0x82
    ILLEGAL_PARAMETER_VALUE = 0x83
    ILLEGAL_OUTPUT_NUMBER = 0x84
    ILLEGAL_OUTPUT_VALUE = 0x85
    ILLEGAL_COMMAND_DFS = 0x86
    ANALOG_OUTPUT_NOT_COMMANDED_BY_LINK = 0x87
    ILLEGAL_ANALOG_VALUE = 0x88
    ILLEGAL_COMMAND = 0x89


_UNIT_ERRORS: dict[int, Message] = {
    UnitErrorCode.NOT_REMOTE: Message("unit_not_remote"),
    UnitErrorCode.ILLEGAL_SPEED: Message("illegal_speed"),
    UnitErrorCode.ILLEGAL_PARAMETER_NUMBER: Message("illegal_parameter_number"),
    UnitErrorCode.ILLEGAL_PARAMETER_VALUE: Message("illegal_parameter_value"),
    UnitErrorCode.ILLEGAL_OUTPUT_NUMBER: Message("illegal_output_number"),
    UnitErrorCode.ILLEGAL_OUTPUT_VALUE: Message("illegal_output_value"),
    UnitErrorCode.ILLEGAL_COMMAND_DFS: Message("illegal_command"),
    UnitErrorCode.ANALOG_OUTPUT_NOT_COMMANDED_BY_LINK: Message("analog_output_not_by_link"),
    UnitErrorCode.ILLEGAL_ANALOG_VALUE: Message("illegal_analog_value"),
    UnitErrorCode.ILLEGAL_COMMAND: Message("illegal_command"),
}


def unit_error(code: int) -> Message:
    """Return the meaning of a NAK's error byte (128-137 known; any other is shown by its number)."""
    return _UNIT_ERRORS.get(code) or Message("error_not_in_manual", {"code": f"{code:02X}"})


def unit_refused(unit: int, code: int) -> Message:
    return Message("unit_refused", {"unit": unit, "error": unit_error(code)})


def unit_error_name(code: int) -> str:
    """Return the meaning of a NAK's error byte, in English."""
    return str(unit_error(code))
