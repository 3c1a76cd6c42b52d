"""All abnormal conditions by code, and what tiles name by the code of its cause. Pure."""

from __future__ import annotations

from typing import Any, Literal

from app.line.conditions.condition import Condition
from app.line.conditions.of_bus import OF_BUS
from app.line.conditions.of_server import OF_SERVER
from app.line.conditions.of_unit import BY_READING, OF_UNIT
from bus.messages import TEXTS, Message, ParamValue

Place = Literal["unit", "bus", "server"]
PLACES: dict[Place, tuple[Condition[Any], ...]] = {"unit": OF_UNIT, "bus": OF_BUS, "server": OF_SERVER}
CONDITIONS = {row.code: row for rows in PLACES.values() for row in rows}
TILES = {cause: row for row in CONDITIONS.values() for cause in row.tiles}
STATUS = {row.code: row.status for row in BY_READING if row.status is not None}
"""The conditions that are single bits of ST1 or ST2 (manual, 81h)."""
UNIT_ALARMS, BUS_ALARMS, SERVER_ALARMS = (
    tuple(row.code for row in rows if row.is_alarm) for rows in PLACES.values()
)


def tile_text(cause: str, **params: ParamValue) -> Message | None:
    """What a tile names of a cause; None where that has no words in advance."""
    message = Message.of(f"tile_{cause}", **params)
    return message if message.code in TEXTS else None


def tile_check(cause: str) -> Message | None:
    """What to check for a cause; None where only time or a decision helps."""
    message = Message(f"tile_{cause}_check")
    return message if message.code in TEXTS else None
