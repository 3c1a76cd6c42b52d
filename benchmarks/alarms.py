"""What alarms cost: 255 units with 20 alarms each at 4 readings a second, and a flood of 10,000 changes."""

from __future__ import annotations

import asyncio
import random
import tempfile
import time
from pathlib import Path
from typing import Any

from app.core.database import Database
from app.line.live.bus_live import BusLive, LiveState
from benchmarks import alarm_screen
from benchmarks.tables import microseconds, show
from bus.contract import ParameterValue, Reading
from bus.instants import UnixTime
from tests.app.alarm_bus import AT_SPEED, BUS, HEALTHY, REMOTE, RUN, AlarmBus

UNITS = 255
READINGS_A_SECOND = 4
PASSES = 40
FLOOD_PASSES = 40
OWN: tuple[dict[str, Any], ...] = (
    {"value": "actual", "below": "20"},
    {"value": "actual", "below": "10"},
    {"value": "actual", "above": "180"},
    {"value": "actual", "above": "190"},
    {"value": "actual", "change_per_s": "50"},
    {"value": "commanded", "above": "190"},
    {"value": "deviation", "above": "20"},
    {"value": "analog", "above": "90"},
    {"value": "run", "state": "off"},
    {"value": "output.1", "state": "on", "on_delay_s": 60.0},
)


def run() -> None:
    """Print one table."""
    with tempfile.TemporaryDirectory() as folder:
        database = Database(Path(folder) / "store.db")
        reading_s, tick_s = _steady(database)
        changes, change_s = asyncio.run(_flood(database))
        database.close()
    share = reading_s * UNITS * READINGS_A_SECOND + tick_s
    rows = [
        ["a reading", microseconds(reading_s)],
        [
            f"{UNITS} units with 20 alarms each, {READINGS_A_SECOND} readings a second",
            f"{share:.1%} of a core",
        ],
        [f"a change, written, in a flood of {changes}", microseconds(change_s)],
    ]
    show("alarms", ["", "CPU"], rows, "The share should be at most 2 %; the least of five passes counts.")
    alarm_screen.run()


def _steady(database: Database) -> tuple[float, float]:
    """CPU seconds of a reading, and of what is looked at every second."""
    own = [{**each, "unit": unit, "name": f"{unit} {each}"} for unit in range(1, UNITS + 1) for each in OWN]
    bus = AlarmBus(database, *own, units=UNITS)
    bus.connect()
    for number, raw in ((22, 0), (23, 100)):
        bus.apply(*(ParameterValue(unit, number, bus.now, raw) for unit in range(1, UNITS + 1)))
    alone = LiveState([bus.settings], UnixTime(bus.now)).buses[BUS]
    reading_s = min(_pass(bus, alone) for _ in range(5))
    began = time.process_time()
    bus.alarms.tick()
    return reading_s, time.process_time() - began


def _pass(bus: AlarmBus, alone: BusLive) -> float:
    dice = random.Random(14)
    spent_s = 0.0
    for _ in range(PASSES):
        bus.now += 1 / READINGS_A_SECOND
        readings = [
            Reading(unit, bus.now, 1000, 1000 + dice.randint(-3, 3), 51, REMOTE | AT_SPEED, RUN | HEALTHY)
            for unit in range(1, UNITS + 1)
        ]
        spent_s += _seconds(bus.live, readings) - _seconds(alone, readings)
    return spent_s / PASSES / UNITS


def _seconds(live: BusLive, readings: list[Reading]) -> float:
    began = time.process_time()
    live.apply(readings)
    return time.process_time() - began


async def _flood(database: Database) -> tuple[int, float]:
    bus = AlarmBus(database, units=UNITS)
    bus.connect()
    began = time.process_time()
    for number in range(FLOOD_PASSES):
        for unit in range(1, UNITS + 1):
            bus.now += 0.005
            bus.read(unit, inputs=RUN | HEALTHY * (number % 2))
        await bus.alarms.list.write()
    spent_s = time.process_time() - began
    changes = len(await bus.store.journal(1_000_000, None))
    return changes, spent_s / changes
