"""The next step until the first unit of a bus responds."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.core.web.access import Role
from app.line.live.bus_live import LiveState
from app.line.live.pages import next_step
from bus.contract import BusLink
from bus.instants import UnixTime
from tests.app.complete_app import complete_app
from tests.app.played_commands import a_bus, responding


def test_the_steps_in_their_order() -> None:
    live = a_bus()
    bus = live.buses["dry-end"]
    assert next_step(bus) == "worker"
    bus.worker_lost = None
    bus.apply([BusLink(at=1.0, link="closed")])
    assert next_step(bus) == "port"
    bus.apply([BusLink(at=1.0, link="open")])
    assert next_step(bus) == "scan"
    responding(live)
    assert next_step(bus) is None


def test_a_unit_that_responded_before_the_server_started_ends_them() -> None:
    bus = a_bus().buses["dry-end"]
    bus.units[2].last_response = UnixTime(1.0)
    assert next_step(bus) is None


@pytest.mark.parametrize("link", ["worker", "port", "scan"])
async def test_an_engineer_is_guided_and_others_are_not(tmp_path: Path, link: str) -> None:
    async with complete_app(tmp_path) as house:
        engineer, operator = await house.signed_in(Role.ENGINEER), await house.signed_in(Role.OPERATOR)
        live = house.services[LiveState]
        bus = live.buses["dry-end"]
        bus.worker_lost = bus.worker_lost if link == "worker" else None
        bus.apply([BusLink(at=UnixTime(1.0), link="open" if link == "scan" else "closed")])
        page = (await engineer.get("/")).text
        assert f'data-first-step="{link}"' in page
        assert "First steps" not in (await operator.get("/")).text
        assert (await operator.get("/bus/dry-end/first-steps")).status_code == 403
        fragment = await engineer.get("/bus/dry-end/first-steps")
        assert ("No unit has responded yet" in fragment.text, "HX-Redirect" in fragment.headers) == (
            True,
            False,
        )
        responding(live)
        assert (await engineer.get("/bus/dry-end/first-steps")).headers["HX-Redirect"] == "/"
