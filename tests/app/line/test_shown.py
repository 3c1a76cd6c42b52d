"""The OpenAPI document's fields are exactly those of the responses."""

from __future__ import annotations

import time

import pytest
from pydantic import ConfigDict, TypeAdapter

from app.line.commands.api.responses import CommandResult, result_json
from app.line.live.api.schemas import BusShown, CauseShown, ParameterShown, UnitShown
from app.line.live.api.view import parameter_json
from app.line.live.bus_live import LiveState
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Command, Frame, Result, UnitOutcome, Update
from bus.messages import term
from tests.app.screens import line_view
from tests.app.stage import Stage, bus_settings, result_of, snapshot

EXACT = ConfigDict(extra="forbid", strict=True)


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is converted, and nothing is left over. TypeAdapter takes it from the class alone, of which
    apps and other tests make schemas."""
    for kind in (BusShown, UnitShown, ParameterShown, CommandResult):
        monkeypatch.setattr(kind, "__pydantic_config__", EXACT, raising=False)


@pytest.mark.usefixtures("exact")
def test_units_and_buses_read_and_unread() -> None:
    live = LiveState([bus_settings()], time.time())
    view = line_view(live, blocks={1: "belt off"})
    for _ in range(2):
        bus = view.bus("dry-end", time.time())
        TypeAdapter(BusShown).validate_python(bus)
        for unit in bus["units"]:
            TypeAdapter(UnitShown).validate_python(unit)
            assert unit.keys() == UnitShown.__annotations__.keys()
            assert unit["cause"].keys() == CauseShown.__annotations__.keys()
        live.buses["dry-end"].connect_worker(snapshot())
    for number in PARAMETERS:
        row = parameter_json(live.buses["dry-end"].units[1], number)
        TypeAdapter(ParameterShown).validate_python(row)


@pytest.mark.usefixtures("exact")
def test_outcomes() -> None:
    live = LiveState([bus_settings()], time.time())
    frame = Frame(at=1.0, direction="out", data=b"x", meanings=[term("m")])
    parts = [UnitOutcome(unit=1, outcome="verified", sent_at=1.0, proven_at=2.0, attempts=1)]
    result = Result(id="a", at=1.0, outcome="verified", units=parts, frames=[frame])
    for unit in (None, 1):
        result_of = result_json(live.buses["dry-end"], result, unit)
        TypeAdapter(CommandResult).validate_python(result_of)


async def test_the_api_gives_them(stage: Stage) -> None:
    worker = await stage.worker()

    async def unresponsive(command: Command) -> list[Update]:
        return [result_of(command, "unverified", message=term("no response"))]

    worker.play = unresponsive
    for path in ("/units/1", "", "/units/1/parameters"):
        assert (await stage.request("GET", path)).status_code == 200
    assert (await stage.http().get("/api/v1/line")).status_code == 200
