"""What the manual rules out (81h and the parameters) is shown as implausible, and is no value anywhere."""

from __future__ import annotations

import time
from typing import Any

import pytest
from msgspec.structs import replace

from app.core.database import Database
from app.line.feed.plausibility import believed_reading, judge_snapshot
from app.line.live.api.view import parameter_json
from app.line.live.fields import unit_fields
from bus.contract import ParameterValue, Reading
from tests.app.alarm_bus import HEALTHY, REMOTE, RUN, AlarmBus
from tests.app.complete_app import House
from tests.app.conftest import Kept
from tests.app.fake_worker import reading, snapshot, unit_state, until
from tests.app.screens import line as screen_line
from tests.app.screens import reading as seen_reading
from tests.app.screens import translator

NEGATIVE = 4_294_967_196
"""-100 as the two's complement of four bytes."""
BEYOND = (100_000, NEGATIVE)
SPEEDS = ("commanded", "actual")


@pytest.mark.parametrize("field", SPEEDS)
@pytest.mark.parametrize("raw", BEYOND)
def test_a_speed_beyond_the_manual_is_none_with_what_the_unit_sent(field: str, raw: int) -> None:
    sent: dict[str, Any] = {"commanded": 528, "actual": 4099, "analog": 7, "outputs": 0xC1, "inputs": 0x03}
    found = believed_reading(Reading(unit=1, at=time.time(), **sent | {field: raw}))  # type: ignore[arg-type]
    speeds = b"".join((sent | {field: raw})[name].to_bytes(4, "big") for name in SPEEDS)
    assert getattr(found, field) is None
    assert found.deviation is None
    assert found.implausible == speeds + b"\x07\xc1\x03"
    assert (found.analog, found.outputs, found.inputs) == (7, 0xC1, 0x03)


def test_the_ends_of_the_range_are_taken_as_they_are() -> None:
    for raw in (0, 99_999):
        found = reading(1, raw, actual=raw)
        assert believed_reading(found) is found


def test_in_a_snapshot_too() -> None:
    state = unit_state(1)
    state = type(state)(1, state.link, reading(1, actual=NEGATIVE))
    [judged] = judge_snapshot(snapshot(units=[state]), (1,), time.time()).units  # type: ignore[arg-type]
    assert judged.reading is not None
    assert judged.reading.actual is None


async def test_it_is_shown_so_and_neither_stored_nor_counted(site: House, kept: Kept) -> None:
    worker = await site.worker()
    await worker.update(reading(1, 900, actual=900), reading(2, 900, actual=900))
    await until(lambda: len(kept.readings) == 2, "the first readings")
    await worker.update(reading(1, 900, actual=NEGATIVE), reading(2, 901, actual=901))
    await until(lambda: len(kept.readings) == 4, "the reading of unit 2")
    assert [each.actual for each in kept.readings] == [900, 900, None, 901]
    unit = (await site.http().get("/api/v1/buses/dry-end/units/1")).json()
    shown = ("commanded_raw", "actual_raw", "actual", "deviation_raw", "deviation", "rpm", "draw")
    assert [unit[name] for name in shown] == [900, None, None, None, None, None, None]
    assert unit["implausible"].startswith("00 00 03 84 FF FF FF 9C ")
    assert unit["inputs"] is not None
    assert unit["link"] == "online"
    await worker.update(reading(1, 900, actual=902))
    await until(lambda: len(kept.readings) == 5, "the next reading")
    assert (await site.http().get("/api/v1/buses/dry-end/units/1")).json()["implausible"] is None


def test_a_page_has_it_in_words() -> None:
    live = screen_line()
    live.buses["dry"].apply([believed_reading(seen_reading(1, actual=NEGATIVE))])
    bus = live.buses["dry"]
    fields = unit_fields(bus, bus.units[1], "online", translator())
    assert (fields["actual"], fields["fill"], fields["off"], fields["state"]) == ("implausible", "", "", "")
    assert fields["commanded"] != "implausible"


@pytest.fixture
def bus(database: Database) -> AlarmBus:
    found = AlarmBus(database)
    found.connect()
    found.wait(2, 1, 2, 3)
    return found


def test_it_is_one_alarm_with_its_bytes(bus: AlarmBus) -> None:
    parameter = ParameterValue(1, 2, bus.now, 100_000)  # type: ignore[arg-type]
    sent = Reading(1, bus.now, 1000, NEGATIVE, 51, REMOTE, RUN | HEALTHY)  # type: ignore[arg-type]
    bus.wait(1, 1, 2, 3, actual=None, implausible=believed_reading(sent).implausible)
    bus.apply(parameter)
    assert bus.present() == {"1.value_implausible", "2.value_implausible", "3.value_implausible"}
    present = str(bus.alarms.present(bus.alarm("1.value_implausible")))
    assert "00 00 03 E8 FF FF FF 9C 33 40 03" in present
    assert "Maximum Display Value (parameter 2): 100000" in present
    bus.wait(10, 1, 2, 3)
    assert bus.state("1.value_implausible") == "unack_active", "the parameter still is"
    assert bus.state("2.value_implausible") == "rtn_unack"
    bus.apply(replace(parameter, raw=20_000))
    bus.wait(10, 1, 2, 3)
    assert bus.state("1.value_implausible") == "rtn_unack"


OUTSIDE = [(1, 65_536), (2, NEGATIVE), (3, 5), (8, 3), (23, 1000), (31, 80_000)]


@pytest.mark.parametrize(("number", "raw"), OUTSIDE)
def test_a_parameter_scales_and_bounds_nothing(bus: AlarmBus, number: int, raw: int) -> None:
    bus.apply(ParameterValue(1, number, bus.now, raw))  # type: ignore[arg-type]
    unit = bus.live.units[1]
    assert unit.parameter_raw(number) is None
    shown = parameter_json(unit, number)
    assert (shown["raw"], shown["value"], shown["implausible"]) == (raw, None, True)


async def test_a_parameter_is_not_stored_as_a_scale(site: House, kept: Kept) -> None:
    worker = await site.worker()
    await worker.update(
        ParameterValue(1, 3, time.time(), 7),  # type: ignore[arg-type]
        ParameterValue(1, 2, time.time(), 2000),  # type: ignore[arg-type]
    )
    await until(lambda: any(isinstance(each, ParameterValue) for each in kept), "#2")
    assert 7 not in [each.raw for each in kept if isinstance(each, ParameterValue)]
