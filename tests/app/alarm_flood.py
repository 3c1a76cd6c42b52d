"""Changes alarms as fast as it can until it is killed: ``python -m tests.app.alarm_flood STORE``."""

from __future__ import annotations

import asyncio
import random
import sys
from pathlib import Path

from app.core.database import Database
from app.line.alarms import rules
from app.line.alarms.rules import NoTransitionError
from tests.app.alarm_bus import BUS, HEALTHY, RUN, AlarmBus


async def flood(store: Path) -> None:
    """Print a line after each pass that is on disk."""
    bus = AlarmBus(Database(store), units=40)
    bus.alarms.load(await bus.store.load())
    bus.connect()
    dice = random.Random()
    while True:
        for unit in range(1, 41):
            bus.now += 0.01
            bus.read(unit, inputs=dice.choice((RUN, RUN | HEALTHY)))
            alarm = bus.alarms.list.alarms[f"{BUS}.{unit}.estop_active"]
            try:
                acknowledged = rules.acknowledge(alarm.facts, alarm.definition.attributes, bus.now)
            except NoTransitionError:
                continue
            if dice.random() < 0.3:
                bus.alarms.list.apply(alarm, acknowledged, "anna", "")
        await bus.alarms.list.write()
        print("written", flush=True)


if __name__ == "__main__":
    asyncio.run(flood(Path(sys.argv[1])))
