"""Errors by whose fault: the caller's, the unit's, the wire's.

Each message is a sentence that tells a person what happened and what to do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum, IntEnum


class LinesideError(Exception):
    """Base of every error this project raises on purpose; its text is meant for people.

    With ``params`` the text is a template whose ``{names}`` they fill in. Request text belongs in ``params``:
    the template is looked up in the catalog of the reader's language, where request text must never go.
    """

    def __init__(self, template: str = "", *, params: Mapping[str, object] | None = None) -> None:
        super().__init__(template if params is None else template.format(**params))
        self.template = template
        self.params = params

    def text(self, t: Callable[..., str]) -> str:
        """The text in the language whose translation function is ``t``."""
        if self.params is None:
            return t(self.template)
        return t(self.template, **{name: _translated(value, t) for name, value in self.params.items()})


def _translated(value: object, t: Callable[..., str]) -> object:
    """Another error and a fixed term are translated; text and numbers stay as they are."""
    match value:
        case LinesideError():
            return value.text(t)
        case Enum():
            return t(str(value))
        case _:
            return value


class CallerError(LinesideError):
    """What was asked cannot be done as asked; nothing was sent."""


class UnitError(LinesideError):
    """The unit answered, and refused."""

    def __init__(self, unit: int, code: int) -> None:
        super().__init__(f"unit {unit} refused: {unit_error_name(code)}")
        self.unit = unit
        self.code = code


class WireError(LinesideError):
    """The port, the cable or an answer failed; whether the unit acted is not known."""


class UnitErrorCode(IntEnum):
    """[ERR] of a NAK (manual, the command pages)."""

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


_UNIT_ERROR_NAMES: dict[int, str] = {
    UnitErrorCode.NOT_REMOTE: "unit is not in REMOTE mode",
    UnitErrorCode.ILLEGAL_SPEED: "illegal speed value",
    UnitErrorCode.ILLEGAL_PARAMETER_NUMBER: "illegal parameter number",
    UnitErrorCode.ILLEGAL_PARAMETER_VALUE: "illegal parameter value",
    UnitErrorCode.ILLEGAL_OUTPUT_NUMBER: "illegal auxiliary output number",
    UnitErrorCode.ILLEGAL_OUTPUT_VALUE: "illegal auxiliary output value",
    UnitErrorCode.ILLEGAL_COMMAND_DFS: "illegal command",
    UnitErrorCode.ANALOG_OUTPUT_NOT_COMMANDED_BY_LINK: "analog output is not set for link control",
    UnitErrorCode.ILLEGAL_ANALOG_VALUE: "illegal analog output value",
    UnitErrorCode.ILLEGAL_COMMAND: "illegal command",
}


UNNAMED_UNIT_ERROR = "error {code}h, which the manual does not name"


def unit_error_name(code: int) -> str:
    """The words for a NAK's error byte (128-137 known; any other is shown by its number)."""
    return _UNIT_ERROR_NAMES.get(code) or UNNAMED_UNIT_ERROR.format(code=f"{code:02X}")
