"""How long a command may take where its sender gives no timeout."""

from __future__ import annotations

import pytest

from app.commands.rules.timeouts import longest_change_s, timeout_s_for
from app.live.state.bus_live import BusLive
from app.web.deadline import DEFAULT_TIMEOUT_S
from bus.contract.durations import longest_stage_s
from tests.app.played_commands import a_bus


@pytest.fixture
def bus() -> BusLive:
    return a_bus().buses["dry-end"]


def test_a_command_to_one_unit_has_the_default(bus: BusLive) -> None:
    assert timeout_s_for(bus) == DEFAULT_TIMEOUT_S == 2.0


@pytest.mark.parametrize("units", [1, 255])
def test_a_change_of_several_has_the_time_of_their_staging_too(bus: BusLive, units: int) -> None:
    stage_s = longest_stage_s(bus.baud, bus.settings.turnaround_s)
    assert stage_s > 0
    assert timeout_s_for(bus, units) == pytest.approx(DEFAULT_TIMEOUT_S + units * stage_s)
    assert longest_change_s(bus, units) == 2 * timeout_s_for(bus, units)
