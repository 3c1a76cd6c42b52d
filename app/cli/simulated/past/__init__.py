"""The past of a demo: what its simulated line did in the day before, written into its stores."""

from __future__ import annotations

from app.cli.simulated.past.readings import write_readings
from app.cli.simulated.past.records import write_records
from app.cli.simulated.past.story import past_of
from app.settings import Settings
from bus.instants import unix_now
from bus.simulator.demo import DemoLine


def write_past(settings: Settings, line: DemoLine) -> None:
    """Write a day of history, alarms, events, recipes, sets and notes before the dashboard opens its stores.
    Raises StoreError."""
    past = past_of(line, unix_now())
    write_readings(settings, past)
    write_records(settings, past)
