"""The line, a bus, a unit and its figures over HTTP."""

from __future__ import annotations

from bus.contract import BusFigures, UnitFigures
from bus.messages import Message
from tests.app.stage import Stage, until


async def test_the_line_a_bus_a_unit(stage: Stage) -> None:
    await stage.worker()
    line = (await stage.http("viewer").get("/api/v1/line")).json()
    assert line["site"] == "Test line"
    bus = (await stage.http("viewer").get("/api/v1/buses/dry-end")).json()
    assert [unit["id"] for unit in bus["units"]] == [1, 2, 16]
    unit = (await stage.request("GET", "/units/16", role="viewer")).json()
    assert (unit["name"], unit["link"], unit["commanded"]) == ("Unit 16", "online", "100.0")


async def test_figures_before_and_after_they_are_measured(stage: Stage) -> None:
    worker = await stage.worker()
    assert (await stage.request("GET", "/figures", role="viewer")).json()["measured"] is False
    units = [UnitFigures(unit=1, polls=9, naks={128: 2})]
    await worker.update(BusFigures(1.0, 12.0, 0.08, 0.98, 0.1, units=units))
    await until(lambda: stage.live.buses["dry-end"].figures is not None, "figures")
    figures = (await stage.request("GET", "/figures", role="viewer")).json()
    assert figures["scan_hz"] == 12.0
    assert figures["units"][0]["polls"] == 9
    assert figures["units"][0]["naks"] == [
        {"unit_error": 128, "unit_error_name": "unit is not in REMOTE mode", "count": 2}
    ]


async def test_an_anonymous_client_sees_nothing(stage: Stage) -> None:
    for path in ("", "/units/1", "/figures"):
        assert (await stage.request("GET", path, role="")).status_code == 401


async def test_a_text_is_one_object_with_its_code(stage: Stage) -> None:
    worker = await stage.worker()
    late = Message("diagnosis_no_response")
    await worker.update(BusFigures(1.0, 12.0, 0.08, 0.98, 0.1, responds_for_all=2, diagnosis=[late]))
    await until(lambda: stage.live.buses["dry-end"].figures is not None, "figures")
    await stage.request("POST", "/units/1/block", {"reason": "belt off"}, role="operator")
    bus = (await stage.http("viewer").get("/api/v1/buses/dry-end")).json()
    assert bus["diagnosis"] == [{"code": "diagnosis_no_response", "params": {}, "detail": str(late)}]
    assert bus["link_cause"] is None
    unit = bus["units"][0]
    assert (unit["suspect"]["code"], unit["suspect"]["params"]) == ("suspect_by_duplicates", {"unit": 2})
    assert unit["suspect"]["detail"] == "unit 2 may respond in its place (each response comes twice)"
    assert unit["blocked"]["params"]["reason"] == "belt off"
    assert "belt off" in unit["blocked"]["detail"]
