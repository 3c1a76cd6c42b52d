"""The fault of one field of a request or of the configuration, from pydantic's error."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from bus.messages import Message

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


def fault_message(error: Any) -> Message:
    """The message of one of a ValidationError's ``errors()``."""
    of: Mapping[str, Any] = error.get("ctx", {})
    if error["type"] in _NUMBERS and _DECIMAL_COMMA.fullmatch(str(error["input"])):
        return Message.of("fault_decimal_comma", right=str(error["input"]).strip().replace(",", "."))
    match error["type"]:
        # Of a text that a validator of ours has seen before pydantic measures it.
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
