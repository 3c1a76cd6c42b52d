"""An alarm as a person proposes it: the keys of ``[[alarm]]``, judged as the configuration is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from app.alarms.settings import AlarmSettings, refuse_misplaced
from app.errors import Problem
from bus.messages import Message
from bus.settings import BusSettings
from bus.validation import fault_message


def proposed(written: Mapping[str, Any], buses: Sequence[BusSettings]) -> AlarmSettings:
    """Raises Problem 422 with every fault in words."""
    try:
        settings = AlarmSettings.model_validate(written)
    except ValidationError as error:
        faults = [_fault(details) for details in error.errors()]
        raise Problem(422, "invalid", Message.of("several", messages=[*faults])) from None
    try:
        refuse_misplaced([settings], buses)
    except PydanticCustomError as error:
        raise Problem(422, "invalid", (error.context or {})["message"]) from None
    return settings


def _fault(details: ErrorDetails) -> Message:
    message: Message | None = details.get("ctx", {}).get("message")
    if message is not None:
        return message
    key = ".".join(str(step) for step in details["loc"])
    if details["type"] == "missing":
        return Message.of("own_alarm_lacks", key=key)
    right = fault_message(details)
    return Message.of("configuration_value", key=key, value=repr(details["input"]), right=right)


def in_toml(settings: AlarmSettings) -> str:
    """The entry for lineside.toml; only what is not the default."""
    lines = ["[[alarm]]"]
    for key, value in settings.model_dump(mode="json", exclude_defaults=True).items():
        lines.append(f"{key} = {_toml(value)}")
    return "\n".join(lines)


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    return f"{value:g}" if isinstance(value, float) else str(value)
