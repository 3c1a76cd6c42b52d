"""What a scan found, as a part of a configuration that is read again."""

from __future__ import annotations

import tomllib

from app.cli.wire import bus_table
from app.settings import Settings
from bus.line.examination import Found


def found(unit: int, baud: int = 9600, kind: str = "digimax", **more: object) -> Found:
    return Found(unit, baud, kind, **more)  # type: ignore[arg-type]


def test_it_is_a_bus_of_a_configuration_with_what_the_units_want() -> None:
    text = bus_table('/dev/a "b"', [found(7, checksum_10h="twice", estop_healthy=0), found(12)], 62)
    [bus] = Settings.model_validate(tomllib.loads(text)).bus
    assert (bus.port, bus.baud, bus.turnaround_ms) == ('/dev/a "b"', 9600, 62)
    assert (bus.checksum_10h, bus.estop_healthy) == ("twice", 0)
    assert [(unit.id, unit.name) for unit in bus.unit] == [(7, "Unit 7"), (12, "Unit 12")]


def test_units_of_another_baud_and_other_devices_are_named_beside_it() -> None:
    text = bus_table("/dev/a", [found(1, 4800), found(2), found(3), found(9, kind="foreign")], 50)
    [bus] = Settings.model_validate(tomllib.loads(text)).bus
    assert (bus.baud, [unit.id for unit in bus.unit]) == (9600, [2, 3])
    assert "# Address 1 at 4800 baud: digimax." in text
    assert "# Address 9 at 9600 baud: foreign." in text
