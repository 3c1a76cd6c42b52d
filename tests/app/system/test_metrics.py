"""``/metrics``: the counters of units, buses, browsers and commands, as Prometheus reads them."""

from __future__ import annotations

import time

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from app.core.web.access import Role
from app.line.live.bus_live import LiveState
from app.people.audit.log import EventLog
from bus.contract import BusFigures, BusLink, ParameterValue, Reading, UnitFigures, UnitLink
from bus.instants import unix_now
from tests.app.complete_app import House
from tests.app.intents import intend


async def samples(house: House) -> dict[tuple[str, ...], float]:
    return await samples_for(await house.program(Role.VIEWER))


async def samples_for(program: httpx.AsyncClient) -> dict[tuple[str, ...], float]:
    response = await program.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain; version=")
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(response.text)
        for sample in family.samples
    }


async def test_before_anything_is_known(house: House) -> None:
    found = await samples(house)
    assert found["lineside_bus_open", "dry-end"] == 0
    assert found["lineside_browsers",] == 0
    assert found["lineside_commands_total", "verified"] == 0
    assert not any(name[0] == "lineside_polls_total" for name in found)


async def test_figures_of_the_workers(house: House) -> None:
    now = time.time()
    unit = UnitFigures(unit=2, polls=50, responses=48, timeouts=2, checksum_errors=1, naks={128: 3})
    figures = BusFigures(
        at=now, scan_hz=4.5, scan_s=0.2, wire_utilisation=0.97, scan_s_with_one_more=0.3, units=[unit]
    )
    house.services[LiveState].buses["dry-end"].apply([BusLink(at=now, link="open"), figures])
    found = await samples(house)
    assert found["lineside_polls_total", "dry-end", "2"] == 50
    assert found["lineside_timeouts_total", "dry-end", "2"] == 2
    assert found["lineside_checksum_errors_total", "dry-end", "2"] == 1
    assert found["lineside_naks_total", "dry-end", "128", "2"] == 3
    assert found["lineside_scan_hz", "dry-end"] == 4.5
    assert found["lineside_wire_utilisation", "dry-end"] == 0.97
    assert found["lineside_bus_open", "dry-end"] == 1


async def test_a_unit_has_its_speed_while_it_is_online(house: House) -> None:
    bus, now = house.services[LiveState].buses["dry-end"], unix_now()
    program = await house.program(Role.VIEWER)

    def reading(unit: int, actual: int) -> Reading:
        return Reading(unit=unit, at=now, commanded=1000, actual=actual, inputs=1, outputs=0xC0, analog=0)

    decimals = [ParameterValue(unit=unit, number=3, at=now, raw=1) for unit in (1, 2)]
    online = [UnitLink(unit=unit, at=now, link="online") for unit in (1, 2)]
    bus.worker_lost = None
    bus.apply([BusLink(at=now, link="open"), *decimals, *online, reading(1, 1000), reading(2, 1053)])
    found = await samples_for(program)
    assert found["lineside_unit_online", "dry-end", "2"] == 1
    assert found["lineside_speed_actual", "dry-end", "2"] == 105.3
    assert found["lineside_speed_commanded", "dry-end", "2"] == 100
    assert found["lineside_unit_info", "dry-end", "", "Nip", "2"] == 1
    assert found["lineside_speed_deviation", "dry-end", "2"] == pytest.approx(5.3)
    outputs = {
        name[2]: value for name, value in found.items() if name[:2] == ("lineside_output_on", "dry-end")
    }
    assert outputs == {str(number): 0 for number in range(1, 7)}
    assert found["lineside_worker_linked", "dry-end"] == 1
    assert found["lineside_history_stored",] == 1
    assert found["lineside_history_lost_total",] == 0
    assert any(name[0] == "lineside_build_info" for name in found)
    assert found["lineside_disk_free_bytes",] > 0
    assert found["process_resident_memory_bytes",] > 0
    bus.lose_worker(now)
    found = await samples_for(program)
    assert found["lineside_unit_online", "dry-end", "2"] == 0
    gone = ("lineside_speed", "lineside_output")
    assert not any(name[0].startswith(gone) for name in found), "a gap, and not the last value"
    assert found["lineside_worker_linked", "dry-end"] == 0


async def test_commands_by_their_outcome(house: House) -> None:
    events = house.services[EventLog]
    for outcome in ("verified", "refused", "refused"):
        number = await intend(events, who="a", origin="api", bus="dry-end", unit=1, what="x")
        await events.conclude(number, outcome)  # type: ignore[arg-type]
    await events.record(kind="restore", what="x", outcome="verified")
    found = await samples(house)
    assert found["lineside_commands_total", "verified"] == 1
    assert found["lineside_commands_total", "refused"] == 2
