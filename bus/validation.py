"""Text that people write (names, reasons, comments), and the message for a field filled in wrongly."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator
from pydantic_core import PydanticCustomError

from bus.messages import Message

_UNSEEN = frozenset(("Cc", "Cs", "Zl", "Zp"))
"""Categories of Unicode: control characters, surrogates, separators of lines."""
_JOINING = frozenset("\xad\u061c\u200c\u200d\u200e\u200f")
"""Format characters that scripts, emoji and hyphenation need between letters. All others hide, or turn the
text so that it reads differently from its characters."""
_BLANK = frozenset("\u115f\u1160\u2800\u3164\uffa0")
"""Letters and symbols without a shape."""
_MARKS = frozenset(("Mn", "Me"))
MAX_MARKS = 8
"""The most combining characters in a row; more of them stack over the text above and below."""
_BREAKS = frozenset("\t\n\r")
_CREDENTIALS = re.compile(r"(://)\S+@")
MASK = "…"
"""The text shown in place of a secret."""


def without_credentials(text: str) -> str:
    """Return the text with user and password removed from every URL."""
    return _CREDENTIALS.sub(rf"\1{MASK}@", text)


def composed(text: str) -> str:
    """Return the text with each accented letter as one character (NFC). Some keyboards and programs write it
    as two, which look the same and have to be equal."""
    return unicodedata.normalize("NFC", text)


OneLine = Annotated[str, AfterValidator(lambda text: _seen(text, frozenset()))]
"""The type of a text on one line, such as a name or a reason."""
TypedText = Annotated[str, AfterValidator(composed)]
"""A text that a person types to find a name."""
Lines = Annotated[str, AfterValidator(lambda text: _seen(text, _BREAKS))]
"""The type of a text of several lines, such as a comment."""


def _seen(text: str, allowed: frozenset[str]) -> str:
    """Return the text, composed. Raise ValueError for an invisible character that is not allowed."""
    base = marks = 0
    for place, sign in enumerate(text, 1):
        if sign not in allowed and _is_unseen(sign):
            raise ValueError(Message.of("control_character", n=place, code=f"U+{ord(sign):04X}"))
        if unicodedata.category(sign) in _MARKS:
            marks += 1
        elif sign not in _JOINING:
            base, marks = place, 0
        if marks > MAX_MARKS:
            raise ValueError(Message.of("too_many_marks", n=base, most=MAX_MARKS))
    if text and not text.isspace() and not any(map(_has_shape, text)):
        raise ValueError(Message("nothing_to_see"))
    return composed(text)


def escaped(text: str) -> str:
    """Return the text with a backslash escape for each character that a terminal obeys or does not show,
    except line breaks."""
    return "".join(
        sign.encode("unicode_escape").decode() if sign not in _BREAKS and _is_unseen(sign) else sign
        for sign in text
    )


def _is_unseen(sign: str) -> bool:
    category = unicodedata.category(sign)
    return category in _UNSEEN or (category == "Cf" and sign not in _JOINING)


def _has_shape(sign: str) -> bool:
    return unicodedata.category(sign)[0] in "LNPS" and sign not in _BLANK


_WITHOUT_BOUNDS = {
    "bool_parsing": Message("fault_not_true_or_false"),
    "bool_type": Message("fault_not_true_or_false"),
    "decimal_parsing": Message("fault_not_a_number"),
    "decimal_type": Message("fault_not_a_number"),
    "dict_type": Message("fault_not_a_mapping"),
    "extra_forbidden": Message("fault_no_such_field"),
    "finite_number": Message("fault_not_a_number"),
    "float_parsing": Message("fault_not_a_number"),
    "float_type": Message("fault_not_a_number"),
    "int_from_float": Message("fault_not_an_integer"),
    "int_parsing": Message("fault_not_an_integer"),
    "int_parsing_size": Message("fault_integer_too_large"),
    "int_type": Message("fault_not_an_integer"),
    "list_type": Message("fault_not_a_list"),
    "missing": Message("fault_missing"),
    "model_attributes_type": Message("fault_not_an_object"),
    "model_type": Message("fault_not_a_mapping"),
    "string_type": Message("fault_not_a_text"),
    "tuple_type": Message("fault_not_a_list"),
    "string_unicode": Message("fault_not_a_text"),
}
_WITH_BOUND = {
    "greater_than": ("fault_more_than", "gt"),
    "greater_than_equal": ("fault_at_least", "ge"),
    "less_than": ("fault_less_than", "lt"),
    "less_than_equal": ("fault_at_most", "le"),
    "string_too_long": ("fault_at_most_characters", "max_length"),
    "string_too_short": ("fault_at_least_characters", "min_length"),
    "too_long": ("fault_at_most_items", "max_length"),
    "too_short": ("fault_at_least_items", "min_length"),
}
_NUMBERS = ("decimal_parsing", "float_parsing", "float_type")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+\s*")
_TIMES = ("date_", "datetime_", "time_", "timezone_")


def setting_fault(message: Message, *at: int | str) -> PydanticCustomError:
    """Return the error for a setting, which is shown without its value, because that may be a secret. ``at``:
    the place of the fault within what is validated."""
    return PydanticCustomError("setting", "wrong setting", {"message": message, "at": at})


def fault_message(error: Any) -> Message:
    """Return the message for one of a ValidationError's ``errors()``."""
    of: Mapping[str, Any] = error.get("ctx", {})
    if error["type"] in _NUMBERS and _DECIMAL_COMMA.fullmatch(str(error["input"])):
        return Message.of("fault_decimal_comma", right=str(error["input"]).strip().replace(",", "."))
    match error["type"]:
        # A validator of ours has seen the text before pydantic measures it.
        case "too_long" | "too_short" if isinstance(error["input"], str):
            return fault_message(error | {"type": f"string_{error['type']}"})
        case str(kind) if kind in _WITHOUT_BOUNDS:
            return _WITHOUT_BOUNDS[kind]
        case str(kind) if kind in _WITH_BOUND:
            code, bound = _WITH_BOUND[kind]
            name = "n" if bound.endswith("length") else "limit"
            value = of[bound]
            is_integer = isinstance(value, float) and value.is_integer()
            return Message(code, {name: int(value) if is_integer else value})
        case "string_pattern_mismatch":
            return Message.of("fault_pattern", text=of["pattern"])
        case "literal_error" | "enum":
            return Message.of("fault_allowed", values=of["expected"].replace(" or ", ", "))
        case "value_error" if of["error"].args and isinstance(of["error"].args[0], Message):
            message: Message = of["error"].args[0]
            return message
        case str(kind) if kind.startswith(_TIMES):
            return Message("fault_not_a_time")
        case _:
            return Message("fault_malformed")
