"""``[[alarm]]`` and ``[[built_in_alarm]]`` of lineside.toml: what they set, and each of their faults in
words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from app.core.database import Database
from app.line.alarms.alarm import built_in
from app.line.alarms.settings import BuiltInAlarmSettings, tuning_of
from app.line.conditions.catalogue import CONDITIONS
from bus.contract import ParameterValue
from tests.app.alarm_bus import BUS, AlarmBus
from tests.app.configured import faults_of

CONFIGURED = '[[bus]]\nname = "dry-end"\nport = "/dev/null"\n[[bus.unit]]\nid = 4\nname = "Dryer"\n'
OWN = '[[alarm]]\nname = "Dryer too slow"\nbus = "dry-end"\nunit = 4\n'


def test_an_own_alarm_is_read_as_documented(tmp_path: Path) -> None:
    text = 'value = "actual"\nbelow = "80.0"\non_delay_s = 5.0\noff_delay_s = 2\ndeadband = "0.5"\n'
    assert faults_of(tmp_path, CONFIGURED + OWN + text + 'priority = "high"\nlatch = false\n') == ""
    text = 'value = "output.2"\nstate = "on"\non_delay_s = 600\n'
    assert faults_of(tmp_path, CONFIGURED + OWN + text) == ""


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ('value = "actual"\nbelow = "80"\non_delay_s = -1\n', 13, "on_delay_s = -1"),
        ('value = "speed"\nbelow = "80"\n', 11, "commanded"),
        ('value = "actual"\n', 7, "above, below or both, or a change per second (change_per_s)"),
        ('value = "run"\n', 7, 'write state = "on" or "off"'),
        ('value = "run"\nabove = "1"\n', 7, "run is on or off"),
        ('value = "actual"\nstate = "on"\n', 7, "actual is a number"),
        ('value = "actual"\nbelow = "80"\nabove = "70"\n', 7, "below is not less than above"),
        ('value = "actual"\nbelow = "80"\nabove = "90"\ndeadband = "5"\n', 7, "would never clear"),
        (
            'value = "actual"\nabove = "90"\ndeadband = "91"\n',
            7,
            "deadband is wider than the limits leave room for",
        ),
        ('value = "actual"\nchange_per_s = "5"\ndeadband = "1"\n', 7, "use off_delay_s"),
        ('value = "actual"\nbelow = "nan"\n', 12, "finite number"),
    ],
)
def test_a_fault_of_an_own_alarm_is_named_with_its_line(
    tmp_path: Path, text: str, line: int, words: str
) -> None:
    fault = faults_of(tmp_path, CONFIGURED + OWN + text)
    assert words in fault
    assert fault.startswith(f"FILE:{line}: ")


@pytest.mark.parametrize(
    ("own", "line", "words"),
    [
        (OWN.replace("unit = 4", "unit = 9"), 10, "alarm Dryer too slow: bus dry-end has no unit 9"),
        (OWN.replace("dry-end", "wet-end"), 9, "alarm Dryer too slow: there is no bus wet-end"),
        (OWN + 'value = "actual"\nabove = 1\n' + OWN, 14, "is given twice for bus dry-end"),
    ],
)
def test_an_own_alarm_has_its_unit_and_its_name(tmp_path: Path, own: str, line: int, words: str) -> None:
    fault = faults_of(tmp_path, CONFIGURED + own + 'value = "actual"\nbelow = "80"\n')
    assert words in fault
    assert fault.startswith(f"FILE:{line}: ")


DEVIATION = '[[built_in_alarm]]\ncode = "deviation"\n'
OF_UNIT = 'bus = "dry-end"\nunit = 4\n'


def tuned_bus(database: Database, *entries: dict[str, Any]) -> AlarmBus:
    """Three units whose maximum display value is 200.0."""
    bus = AlarmBus(database, tuned=[BuiltInAlarmSettings(**each) for each in entries])
    bus.connect()
    bus.apply(*(ParameterValue(unit=unit, number=2, at=bus.now, raw=2000) for unit in (1, 2, 3)))
    bus.wait(2, 1, 2, 3)
    return bus


@pytest.mark.parametrize("code", [row.code for row in CONDITIONS.values() if row.is_alarm])
def test_the_delays_of_every_built_in_alarm_can_be_set(code: str) -> None:
    row = CONDITIONS[code]
    entry = BuiltInAlarmSettings(code=code, on_delay_s=7.0)
    tuning = tuning_of([entry], row.code, BUS, 1)
    assert tuning == replace(row.tuning, on_delay_s=7.0)
    assert built_in(row.code, BUS, 1, [entry]).attributes.on_delay_s == 7


@pytest.mark.parametrize("code", [row.code for row in CONDITIONS.values() if not row.is_alarm])
def test_a_condition_without_an_alarm_cannot_be_set(code: str) -> None:
    with pytest.raises(ValidationError):
        BuiltInAlarmSettings(code=code, on_delay_s=7.0)


def test_a_built_in_alarm_is_set_as_documented(tmp_path: Path) -> None:
    everywhere = f'{DEVIATION}above_percent = 3\ndeadband_percent = "0.5"\n'
    assert faults_of(tmp_path, CONFIGURED + everywhere + DEVIATION + OF_UNIT + "on_delay_s = 20\n") == ""


def test_a_unit_comes_before_its_bus_and_that_before_everywhere(database: Database) -> None:
    """At 40 of 2000 away: 2 %."""
    bus = tuned_bus(
        database,
        {"code": "deviation", "bus": BUS, "unit": 2, "above_percent": 3},
        {"code": "deviation", "bus": BUS, "above_percent": "1.5"},
        {"code": "deviation", "above_percent": 4, "off_delay_s": 7.0},
        {"code": "deviation", "bus": BUS, "unit": 3, "on_delay_s": 60.0},
    )
    bus.wait(10, 1, 2, 3, actual=1040)
    assert bus.present() == {"1.deviation"}
    assert {bus.alarm(f"{unit}.deviation").definition.attributes.off_delay_s for unit in (1, 2, 3)} == {7}
    bus.wait(51, 1, 2, 3, actual=1040)
    assert bus.present() == {"1.deviation", "3.deviation"}


def test_a_deadband_decides_when_a_deviation_clears(database: Database) -> None:
    bus = tuned_bus(database, {"code": "deviation", "deadband_percent": 4})
    bus.wait(10, 1, 2, 3, actual=1101)
    bus.wait(10, 1, 2, 3, actual=1021)
    assert bus.state("1.deviation") == "unack_active"
    bus.wait(10, 1, 2, 3, actual=1020)
    assert bus.state("1.deviation") == "rtn_unack"


def test_the_analog_input_has_limits_within_its_range(database: Database) -> None:
    limits = {"above_percent": 80, "below_percent": 10, "deadband_percent": 5}
    bus = tuned_bus(database, {"code": "analog_out_of_limits", **limits, "on_delay_s": 0.0})
    for analog, state in ((204, "normal"), (205, "unack_active"), (192, "unack_active"), (191, "rtn_unack")):
        bus.wait(8, 1, 2, 3, analog=analog)
        assert bus.state("1.analog_out_of_limits") == state, analog
    bus.wait(1, 1, 2, 3, analog=25)
    assert bus.state("1.analog_out_of_limits") == "unack_active"


def test_an_alarm_of_a_bus_has_the_delay_that_is_set(database: Database) -> None:
    bus = tuned_bus(database, {"code": "worker_lost", "on_delay_s": 30.0})
    assert bus.alarm("worker_lost").definition.attributes.on_delay_s == 30
    assert bus.alarm("no_unit_responds").definition.attributes.on_delay_s == 3


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (DEVIATION + "on_delay_s = -1\n", 9, "on_delay_s = -1"),
        (DEVIATION + "above_percent = 101\n", 9, "above_percent = 101"),
        (DEVIATION + 'deadband_percent = "5"\n', 8, "alarm deviation: deadband is wider than the limits"),
        (DEVIATION + "below_percent = 1\n", 9, "alarm deviation has no below_percent; known here: "),
        (DEVIATION, 8, "alarm deviation: nothing is set; write one of above_percent, "),
        (DEVIATION + "unit = 4\nabove_percent = 3\n", 9, "name the bus"),
        (DEVIATION + OF_UNIT.replace("4", "9") + "on_delay_s = 1\n", 10, "bus dry-end has no unit 9"),
        (DEVIATION + OF_UNIT.replace("dry", "wet") + "on_delay_s = 1\n", 9, "there is no bus wet-end"),
        (
            '[[built_in_alarm]]\ncode = "analog_out_of_limits"\nbelow_percent = 99.7\n',
            8,
            "below is not less than above",
        ),
        (
            '[[built_in_alarm]]\ncode = "worker_lost"\n' + OF_UNIT + "on_delay_s = 1\n",
            10,
            "worker_lost is not of one unit",
        ),
        (
            '[[built_in_alarm]]\ncode = "disk_low"\nbus = "dry-end"\non_delay_s = 1\n',
            9,
            "disk_low is of the server",
        ),
        (2 * (DEVIATION + "above_percent = 3\n"), 11, "deviation is set twice for one place"),
        ('[[built_in_alarm]]\ncode = "deviations"\n', 8, "unit_offline"),
    ],
)
def test_a_fault_of_a_built_in_alarm_is_named_with_its_line(
    tmp_path: Path, text: str, line: int, words: str
) -> None:
    fault = faults_of(tmp_path, CONFIGURED + text)
    assert words in fault
    assert fault.startswith(f"FILE:{line}: ")


def test_limits_are_judged_with_those_that_they_are_set_over(tmp_path: Path) -> None:
    everywhere = DEVIATION + "above_percent = 10\ndeadband_percent = 6\n"
    assert faults_of(tmp_path, CONFIGURED + everywhere) == ""
    fault = faults_of(tmp_path, CONFIGURED + everywhere + DEVIATION + OF_UNIT + "above_percent = 5\n")
    assert "deadband is wider than the limits" in fault
    assert fault.startswith("FILE:12: ")
