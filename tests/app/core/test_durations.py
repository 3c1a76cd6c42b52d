"""How long a change of several units may take: the same for the pages, the API, recipes and the worker."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from app.core.web.access import Role
from app.core.web.arrival import Deadline
from app.engineering.recipes.book import RecipeBook
from app.line.commands.catalogue import SCALE_READS, timeout_s_for
from app.line.commands.service import CommandService
from app.line.live.bus_live import LiveState
from bus.contract import BusLink, Result, SetLine
from bus.contract.actions import POLL_BYTES, change_s, longest_stage_s, stage_s
from bus.settings import BAUDS
from tests.app.complete_app import House, complete_app
from tests.app.played_commands import ANNA, a_bus, responding
from tests.for_each import for_each


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState])
        yield house


@for_each("baud", BAUDS)
@for_each("units", [1, 16, 255])
def test_the_worker_never_refuses_for_want_of_time_what_the_app_gives_time_for(units: int, baud: int) -> None:
    live = a_bus()
    live.buses["dry-end"].apply([BusLink(at=1.0, link="open", baud=baud)])
    bus = live.buses["dry-end"]
    assert units * stage_s(baud) < timeout_s_for(bus, units) - 1
    assert units * stage_s(baud, SCALE_READS) < timeout_s_for(bus, units, typed=True) - 1


def test_the_arithmetic_of_the_wire() -> None:
    assert stage_s(9600) == 18 * 10 / 9600
    assert longest_stage_s(300, 0.05) == pytest.approx(22 * 10 / 300 + 0.05)
    assert change_s(3, 9600) == pytest.approx((3 * (18 + POLL_BYTES) + 7) * 10 / 9600)


async def test_pages_programs_and_recipes_give_a_change_the_same_time_at_any_baud(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[float] = []

    async def send(_person: Any, action: Any, *, deadline: Deadline, **_: Any) -> Result:
        assert isinstance(action, SetLine)
        given.append(deadline.timeout_s)
        return Result("x", time.time(), "verified")

    monkeypatch.setattr(house.services.buses["dry-end"][CommandService], "send", send)
    house.services[LiveState].buses["dry-end"].apply([BusLink(at=1.0, link="open", baud=300)])
    operator = await house.signed_in(Role.OPERATOR)
    setpoints = {"raw-1": "700", "was-1": "1000", "raw-2": "800", "was-2": "1000"}
    setpoints |= {"scale-1": "-", "scale-2": "-"}
    form = {"bus": "dry-end", "id": "c" * 32, "reviewed_at": f"{time.time()}"} | setpoints
    for path in ("/setpoints", "/line/zero"):
        assert (await operator.post(path, data=form)).status_code == 200
    body = {"setpoints": {"1": {"raw": 700}, "2": {"raw": 800}}}
    assert (await operator.post("/api/v1/buses/dry-end/speeds", json=body)).status_code == 200
    await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 700, 2: 800})
    assert (await operator.post("/api/v1/recipes/1/load", json={})).status_code == 200
    bus = house.services[LiveState].buses["dry-end"]
    at_zero, typed = timeout_s_for(bus, 2), timeout_s_for(bus, 2, typed=True)
    raw = at_zero
    assert given == [typed, at_zero, raw, typed]
