"""What counts as slower, which is all that may be sent while nothing can be logged in the database."""

from __future__ import annotations

import pytest

from app.line.commands.rules.slowing import slows_all
from app.line.live.state.bus_live import BusLive
from bus.contract import ParameterValue, UnitLink
from tests.app.played_commands import a_bus, responding


@pytest.fixture
def bus() -> BusLive:
    """Two units at 1000."""
    live = a_bus()
    responding(live)
    return live.buses["dry-end"]


@pytest.mark.parametrize(
    ("setpoints", "slower"),
    [
        ({1: 0}, True),
        ({1: 999}, True),
        ({1: 1000}, False),
        ({1: 1001}, False),
        ({1: 900, 2: 0}, True),
        ({1: 900, 2: 1001}, False),
    ],
)
def test_each_unit_has_to_become_slower(bus: BusLive, setpoints: dict[int, int], slower: bool) -> None:
    assert slows_all(setpoints, bus) is slower


def test_of_a_unit_that_is_not_known_now_only_zero_counts(bus: BusLive) -> None:
    bus.apply([UnitLink(unit=1, at=2.0, link="stale")])
    assert slows_all({1: 0}, bus)
    assert not slows_all({1: 1}, bus)


def test_of_a_unit_that_was_never_read_only_zero_counts() -> None:
    never = a_bus().buses["dry-end"]
    assert slows_all({1: 0}, never)
    assert not slows_all({1: 1}, never)


@pytest.mark.parametrize("raw", [0, 1, 999])
def test_a_ratio_of_a_follower_never_counts(bus: BusLive, raw: int) -> None:
    bus.apply([ParameterValue(unit=1, number=8, at=2.0, raw=1)])
    assert not slows_all({1: raw}, bus)
    assert not slows_all({1: raw, 2: 0}, bus)
