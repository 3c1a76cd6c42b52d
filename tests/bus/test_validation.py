"""The fault of a field is a message of ours for every kind of error that pydantic finds in a request."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from decimal import Decimal
from typing import Annotated, Any, Literal

import pytest
from pydantic import AwareDatetime, Field, TypeAdapter, ValidationError

from app.core.web.shape import StrictBody
from bus.validation import OneLine, fault_message


class _Part(StrictBody):
    n: int


_CASES: list[tuple[Any, Any, str]] = [
    (bool, "maybe", "it must be true or false"),
    (bool, [], "it must be true or false"),
    (int, "x", "it must be an integer"),
    (int, 1.5, "it must be an integer"),
    (int, "9" * 5000, "it is too large an integer"),
    (float, "x", "it must be a finite number"),
    (Annotated[float, Field(allow_inf_nan=False)], float("nan"), "it must be a finite number"),
    (Annotated[float, Field(gt=0)], 0, "it must be more than 0"),
    (Annotated[float, Field(lt=0)], 0, "it must be less than 0"),
    (Annotated[int, Field(ge=1)], 0, "it must be at least 1"),
    (Annotated[int, Field(le=1)], 2, "it must be at most 1"),
    (str, 1, "it must be a text"),
    (Annotated[str, Field(min_length=2)], "x", "it must have at least 2 characters"),
    (Annotated[str, Field(max_length=1)], "xx", "it must have at most 1 character"),
    (Annotated[OneLine, Field(min_length=2)], "x", "it must have at least 2 characters"),
    (Annotated[OneLine, Field(max_length=1)], "xx", "it must have at most 1 character"),
    (Annotated[str, Field(pattern="^a")], "b", "it must match the pattern '^a'"),
    (Literal["on", "off"], "x", "it must be one of 'on', 'off'"),
    (Annotated[list[int], Field(max_length=1)], [1, 2], "it must have at most 1 item"),
    (Annotated[dict[str, int], Field(min_length=1)], {}, "it must have at least 1 item"),
    (list[int], 1, "it must be a list"),
    (dict[str, int], 1, "it must be an object with named fields"),
    (_Part, 1, "it must be an object with named fields"),
    (_Part, {}, "it is missing"),
    (_Part, {"n": 1, "x": 1}, "there is no such field"),
    (AwareDatetime, "2026-11-22", "it must be a time in ISO 8601 with its zone, like 2026-11-22T06:00:00Z"),
    (datetime, "soon", "it must be a time in ISO 8601 with its zone, like 2026-11-22T06:00:00Z"),
    (Decimal, "80,5", "write it with a decimal point: 80.5"),
    (float, "-1,25", "write it with a decimal point: -1.25"),
    (Decimal, "1,2,3", "it must be a finite number"),
    (Callable[[], None], 1, "it is malformed"),
]


@pytest.mark.parametrize(("type_", "value", "text"), _CASES, ids=lambda each: str(each)[:40])
def test_a_fault_has_a_text_of_ours(type_: Any, value: Any, text: str) -> None:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(type_).validate_python(value)
    fault = fault_message(caught.value.errors()[0])
    assert (str(fault), fault.code.startswith("fault_")) == (text, True)
