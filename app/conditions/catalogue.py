"""All abnormal conditions by code, and what tiles name by the code of its cause. Pure."""

from __future__ import annotations

from typing import Any, Literal

from app.conditions.condition import Condition
from app.conditions.of_bus import OF_BUS
from app.conditions.of_server import OF_SERVER
from app.conditions.of_unit import BY_READING, OF_UNIT

Place = Literal["unit", "bus", "server"]
PLACES: dict[Place, tuple[Condition[Any], ...]] = {"unit": OF_UNIT, "bus": OF_BUS, "server": OF_SERVER}
CONDITIONS = {row.code: row for rows in PLACES.values() for row in rows}
TILES = {tile.cause or row.code: (row, tile) for row in CONDITIONS.values() for tile in row.tiles}
STATUS = {row.code: row.status for row in BY_READING if row.status is not None}
"""Those of single bits of ST1 or ST2 (manual, 81h)."""
UNIT_ALARMS, BUS_ALARMS, SERVER_ALARMS = (
    tuple(row.code for row in rows if row.is_alarm) for rows in PLACES.values()
)
