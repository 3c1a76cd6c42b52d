"""The fault of one field of a request, from pydantic's error."""

from __future__ import annotations

from typing import Any

from bus.messages import Message

_WITHOUT_BOUNDS = {
    "model_attributes_type": Message("fault_not_an_object"),
    "extra_forbidden": Message("fault_no_such_field"),
    "missing": Message("fault_missing"),
    "int_parsing": Message("fault_integer_unreadable"),
    "int_type": Message("fault_not_an_integer"),
    "float_parsing": Message("fault_number_unreadable"),
    "float_type": Message("fault_not_a_number"),
    "string_type": Message("fault_not_a_text"),
}


def fault_message(error: Any) -> Message:
    """The message of one of a ValidationError's ``errors()``; in pydantic's words where there is none."""
    of = error.get("ctx", {})
    match error["type"]:
        case str(kind) if kind in _WITHOUT_BOUNDS:
            return _WITHOUT_BOUNDS[kind]
        case "string_too_long":
            return Message.of("fault_at_most_characters", n=of["max_length"])
        case "string_too_short":
            return Message.of("fault_at_least_characters", n=of["min_length"])
        case "string_pattern_mismatch":
            return Message.of("fault_pattern", text=f"'{of['pattern']}'")
        case "greater_than_equal":
            return Message.of("fault_at_least", limit=of["ge"])
        case "less_than_equal":
            return Message.of("fault_at_most", limit=of["le"])
        case "literal_error" | "enum":
            return Message.of("fault_allowed", values=of["expected"])
        case "value_error" if of["error"].args and isinstance(of["error"].args[0], Message):
            message: Message = of["error"].args[0]
            return message
        case _:
            return Message.of("fault_other", text=str(error["msg"]).removeprefix("Value error, "))
