"""The readings of the past, written as the blocks and rollups into which the history packs them."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import closing
from itertools import groupby

from app.cli.simulated.past.story import MAX_UNITS, Past, Stretch, setpoint_of
from app.database import Database, StoreConnection
from app.history import recorder, tables
from app.history.series.rollup import combine, minute_rollups
from app.history.series.runs import DAY, HOUR, MINUTE, SECOND, PlainRun, micros
from app.history.series.values import DECIDING, Marks, ParameterStep, intervals
from app.history.service import FILE
from app.history.writer import MIGRATIONS
from app.settings import Settings
from bus.simulator.section import TENSION_AT_REST, TENSION_RUNNING
from bus.simulator.unit import Unit

_ESTOPPED, _AT_SPEED = 0x4001, 0xC003
"""ST2 * 256 + ST1: in REMOTE with run; at speed, or with the e-stop input active."""
_UNREST = 2
"""How far the speed departs from its setpoint, in display units."""


def write_readings(settings: Settings, past: Past) -> None:
    """Write the readings of the day into a new history store. Raises StoreError."""
    bus = settings.bus[0].name
    file = settings.server.data / FILE
    with closing(Database(file, MIGRATIONS, "NORMAL")) as database:
        database.write_now(lambda connection: _write(connection, bus, past))


def _write(connection: StoreConnection, bus: str, past: Past) -> None:
    for address, unit in enumerate(past.units[:MAX_UNITS], start=1):
        key, stretches = tables.unit_id(connection, bus, address), list(past.stretches(address))
        begins = micros(past.begins)
        for number in DECIDING:
            tables.write_parameter(connection, key, ParameterStep(begins, number, unit.memory[number]))
        for at, state in _links(stretches):
            tables.write_link(connection, key, at, state, "")
        runs = list(_runs(unit, stretches, random.Random(address)))
        _write_blocks(connection, key, runs, _marks(stretches))


def _links(stretches: list[Stretch]) -> list[tuple[int, str]]:
    """When the unit came into which state."""
    states = [(micros(each.begins), "online" if _is_online(each) else "offline") for each in stretches]
    return [next(of) for _, of in groupby(states, key=lambda each: each[1])]


def _marks(stretches: list[Stretch]) -> Marks:
    links = _links(stretches)
    lost = [at for at, state in links if state == "offline"]
    return Marks(lost, [at for at, state in links if state == "online"])


def _write_blocks(connection: StoreConnection, key: int, runs: list[PlainRun], marks: Marks) -> None:
    of_day: dict[int, list[tuple[int, list[PlainRun]]]] = {}
    for hour, of in groupby(runs, key=lambda run: run[0] - run[0] % HOUR):
        of_day.setdefault(hour - hour % DAY, []).append((hour, list(of)))
    for day, hours in of_day.items():
        rollups = []
        for hour, rows_of_hour in hours:
            table = list(zip(*rows_of_hour, strict=True))
            tables.write_raw(connection, key, hour, HOUR, table)
            rows = minute_rollups(table)
            tables.write_rollups(connection, "minutes", key, hour, rows)
            rollups.append(combine(rows, hour))
        tables.write_rollups(connection, "hours", key, day, rollups)
    bits = intervals(((run[0], run[1], run[6]) for run in runs), marks, MINUTE)
    recorder.replace_bits(connection, {key: ()}, {key: bits})


def _is_online(stretch: Stretch) -> bool:
    return stretch.incident is None or stretch.incident.code != "unit_offline"


def _runs(unit: Unit, stretches: list[Stretch], noise: random.Random) -> Iterator[PlainRun]:
    """One run a minute, and another where something changes."""
    for stretch in filter(_is_online, stretches):
        commanded = setpoint_of(unit, stretch.share)
        at, ends = micros(stretch.begins), micros(stretch.ends)
        while at < ends:
            until = min(at - at % MINUTE + MINUTE, ends)
            seconds = (until - at) // SECOND
            if seconds:
                values = _values(commanded, stretch, noise)
                yield at, at + (seconds - 1) * SECOND, seconds, commanded, *values
            at = until


def _values(commanded: int, stretch: Stretch, noise: random.Random) -> tuple[int, int, int]:
    """Actual speed, analog input and bits."""
    word = _AT_SPEED if stretch.incident is None else _ESTOPPED
    if stretch.incident is None and stretch.share:
        return (
            commanded + noise.randint(-_UNREST, _UNREST),
            round(TENSION_RUNNING) + noise.randint(-3, 3),
            word,
        )
    return 0, round(TENSION_AT_REST) + noise.randint(-1, 1), word
