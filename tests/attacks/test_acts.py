"""An account that changes something in a loop: it fills no log, and keeps no one else from anything."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from app.core.web.access import Role
from app.errors import Problem
from app.people.audit.acts import ACTS_PER_S, MAX_ACTS, ActLimit
from bus.instants import Monotonic, monotonic_now
from tests.app.complete_app import House, complete_app
from tests.app.played_line import BUS, played_line

API = f"/api/v1/buses/{BUS}"


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path, control=True) as house:
        await played_line(house.services)
        yield house


def performed(limit: ActLimit, account: str, now: Monotonic) -> bool:
    try:
        limit.count(account, now)
    except Problem:
        return False
    return True


def use_up(limit: ActLimit, account: str) -> None:
    while performed(limit, account, monotonic_now()):
        pass


def test_the_acts_of_an_account_are_bounded_in_the_long_run() -> None:
    limit = ActLimit()
    done = sum(performed(limit, "anna", Monotonic(tick / 100)) for tick in range(10_000))
    assert done == pytest.approx(MAX_ACTS + 100 * ACTS_PER_S, abs=2)
    with pytest.raises(Problem) as refused:
        limit.count("anna", Monotonic(100.0))
    assert (refused.value.status, refused.value.headers["Retry-After"]) == (429, "1")
    limit.count("ben", Monotonic(100.0))


async def test_a_loop_of_acts_is_refused_and_everyone_else_goes_on(house: House) -> None:
    program, ben = await house.program(Role.OPERATOR), await house.signed_in(Role.OPERATOR, "ben")
    assert (await program.post(f"{API}/control/take")).status_code == 200
    assert (await program.post(f"{API}/control/release")).status_code == 200
    account = (await house.events("control"))[0]["who"] + " (token)"
    use_up(house.services[ActLimit], account)
    assert (await program.post(f"{API}/control/take")).status_code == 429
    assert len(await house.events("control")) == 2
    assert (await program.get(f"{API}/control")).status_code == 200
    assert (await ben.post(f"{API}/control/take")).status_code == 200


async def test_pages_acknowledgements_and_commands_are_not_refused(house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER, "eva")
    use_up(house.services[ActLimit], "eva")
    assert (await engineer.get(f"/units/{BUS}/1")).status_code == 200
    absent = await engineer.post("/api/v1/alarms/none.1/acknowledge", json={})
    assert absent.status_code != 429, "an acknowledgement is bounded by the alarms, and nothing delays it"
    speed = await engineer.post(f"{API}/units/1/speed", json={"raw": 100})
    assert speed.status_code != 429, "a command is bounded by the wire"
