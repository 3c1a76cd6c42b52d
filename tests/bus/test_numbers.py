"""The names of the parameter numbers, against the titles that the manual prints (section 4.0)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bus.catalogue import numbers

REPOSITORY = Path(__file__).parents[2]
PRINTED = {
    "Maximum Motor Speed": "MAX_RPM",
    "Maximum Display Value": "MAX_DISPLAY",
    "Decimal Location": "DECIMALS",
    "Base Ratio": "BASE_RATIO",
    "Encoder PPR": "ENCODER_PPR",
    "Acceleration Ramp Rate": "ACCELERATION",
    "Deceleration Ramp Rate": "DECELERATION",
    "Master/Slave/Inverse Mode": "FOLLOWER_MODE",
    "Preset Speed": "PRESET_SPEED",
    "Jump Up Delta": "JUMP_UP",
    "Jump Down Delta": "JUMP_DOWN",
    "Up to Speed Tolerance": "AT_SPEED_WINDOW",
    "MOP/Jump Mode": "JUMP_MODE",
    "Freeze/Float Mode": "FREEZE_MODE",
    "Display Sample Rate": "DISPLAY_RATE",
    "Allow Setup During Run": "SETUP_DURING_RUN",
    "Unit ID Number": "OWN_ADDRESS",
    "Baud Rate": "BAUD_RATE",
    "Local/Remote/Keylock": "CONTROL_MODE",
    "Speed Setpoint": "SPEED_SETPOINT",
    "Operator Password": "PASSWORD",
    "A to D Low Engr Units": "ANALOG_IN_LOW",
    "A to D High Engr Units": "ANALOG_IN_HIGH",
    "A to D Display Mode": "ANALOG_IN_MODE",
    "A to D Sample Rate": "ANALOG_IN_RATE",
    "A to D Trim Enable": "ANALOG_IN_TRIM",
    "Communications Protocol": "PROTOCOL",
    "D to A Source": "ANALOG_OUT_SOURCE",
    "D to A Low Engineering Units": "ANALOG_OUT_LOW",
    "D to A High Engineering Units": "ANALOG_OUT_HIGH",
    "Maximum Ratio": "MAX_RATIO",
    "Preset Input Mode": "PRESET_INPUT_MODE",
    "Reverse Input Mode": "REVERSE_INPUT_MODE",
    "Up Input Mode": "UP_INPUT_MODE",
    "Down Input Mode": "DOWN_INPUT_MODE",
    "Installed Option Enable": "INSTALLED_OPTION",
    "Command Ratio Setpoint": "RATIO_SETPOINT",
    "Minimum Ratio": "MIN_RATIO",
    "Debounce Value": "DEBOUNCE",
    "At Speed Source": "AT_SPEED_SOURCE",
}
"""In the order of the printed list, which begins with 1."""
NAMED = {name: value for name, value in vars(numbers).items() if name.isupper() and isinstance(value, int)}


def test_every_name_stands_for_the_number_of_its_printed_title() -> None:
    assert {name: number for number, name in enumerate(PRINTED.values(), start=1)} == NAMED


@pytest.mark.parametrize("package", ["app", "bus"])
def test_no_other_module_defines_one_of_the_names(package: str) -> None:
    modules = [path for path in (REPOSITORY / package).rglob("*.py") if path.name != "numbers.py"]
    assert len(modules) > 50
    defined = {
        (path.name, name)
        for path in modules
        for names in re.findall(r"^([A-Z_, ]+) = [\d, ]+$", path.read_text(), re.MULTILINE)
        for name in names.split(", ")
        if name.lstrip("_") in NAMED
    }
    assert defined == set()
