"""``[[alarm]]`` of lineside.toml, and each of its faults in words."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.app.configured import faults_of

BUS = '[[bus]]\nname = "dry-end"\nport = "/dev/null"\n[[bus.unit]]\nid = 4\nname = "Dryer"\n'
OWN = '[[alarm]]\nname = "Dryer too slow"\nbus = "dry-end"\nunit = 4\n'


def test_the_example_of_the_documentation_is_read(tmp_path: Path) -> None:
    text = 'value = "actual"\nbelow = "80.0"\non_delay_s = 5.0\noff_delay_s = 2\ndeadband = "0.5"\n'
    assert faults_of(tmp_path, BUS + OWN + text + 'priority = "high"\nlatch = false\n') == ""
    assert faults_of(tmp_path, BUS + OWN + 'value = "output.2"\nstate = "on"\non_delay_s = 600\n') == ""


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
def test_a_fault_is_named_with_its_line(tmp_path: Path, text: str, line: int, words: str) -> None:
    fault = faults_of(tmp_path, BUS + OWN + text)
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
def test_an_alarm_has_its_unit_and_its_name(tmp_path: Path, own: str, line: int, words: str) -> None:
    fault = faults_of(tmp_path, BUS + own + 'value = "actual"\nbelow = "80"\n')
    assert words in fault
    assert fault.startswith(f"FILE:{line}: ")
