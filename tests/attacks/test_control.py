"""Control that is granted by another, too late or twice; requests and other acts without end."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

import app.line.commands.safeguards as service_module
from app.core.web.access import Role
from app.errors import Problem
from app.line.commands.control import REQUEST_LAPSES_AFTER_S
from app.line.commands.safeguards import MAX_REQUESTS
from app.people.audit.acts import ACTS_PER_S, MAX_ACTS, ActLimit
from bus.instants import Monotonic, monotonic_now
from tests.app.complete_app import House, complete_app
from tests.app.played_line import BUS, played_line
from tests.attacks.withdrawals import withdraw
from tests.sizes import in_turn

API = f"/api/v1/buses/{BUS}/control"


WAYS_TO_LEAVE = ("signed out", "removed", "disabled", "demoted", "made again")
Leaver = tuple[str, set[int], str | None]
LEAVERS: list[Leaver] = [("ben", {409, 422}, "anna"), ("anna", {401, 403}, None)]
"""Who leaves, how a grant is refused then, and who holds control."""


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path, control=True) as house:
        await played_line(house.services)
        yield house


@pytest.fixture
async def anna(house: House) -> httpx.AsyncClient:
    """Holds control."""
    client = await house.signed_in(Role.OPERATOR, "anna")
    assert (await client.post(f"{API}/take")).status_code == 200
    return client


@pytest.fixture
async def ben(house: House) -> httpx.AsyncClient:
    return await house.signed_in(Role.OPERATOR, "ben")


async def holder(client: httpx.AsyncClient) -> str | None:
    found: str | None = (await client.get(API)).json()["holder"]
    return found


async def press(client: httpx.AsyncClient, do: str, to: str = "") -> str:
    return (await client.post(f"/bus/{BUS}/control", data={"do": do, "to": to})).text


async def test_only_its_holder_grants_it_once(
    house: House, anna: httpx.AsyncClient, ben: httpx.AsyncClient
) -> None:
    eve = await house.signed_in(Role.OPERATOR, "eve")
    admin = await house.signed_in(Role.ADMIN, "boss")
    assert (await anna.post(f"{API}/grant")).status_code == 409
    assert (await ben.post(f"{API}/request")).status_code == 200
    granted = [(await client.post(f"{API}/grant")).status_code for client in (eve, ben, admin, anna, anna)]
    assert granted == [409, 409, 409, 200, 409]
    assert await holder(eve) == "ben"


async def test_a_grant_is_for_whom_the_holder_saw(
    house: House, anna: httpx.AsyncClient, ben: httpx.AsyncClient
) -> None:
    """Ben withdraws and Eve requests while the page of Anna still names Ben."""
    eve = await house.signed_in(Role.OPERATOR, "eve")
    await ben.post(f"{API}/request")
    seen = (await anna.get("/control")).text
    assert '"to": "ben"' in seen
    await ben.delete(f"{API}/request")
    await eve.post(f"{API}/request")
    for do in ("grant", "decline"):
        await press(anna, do, "ben")
        shown = (await anna.get(API)).json()
        assert (shown["holder"], shown["request"]["state"]) == ("anna", "pending")
    await press(eve, "withdraw")
    await ben.post(f"{API}/request")
    await press(eve, "withdraw")
    assert (await anna.get(API)).json()["request"]["by"] == "ben"
    await press(anna, "grant", "ben")
    assert await holder(anna) == "ben"


async def test_a_lapsed_request_is_not_granted(
    anna: httpx.AsyncClient, ben: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    await ben.post(f"{API}/request")
    monkeypatch.setattr(service_module, "monotonic_now", lambda: monotonic_now() + REQUEST_LAPSES_AFTER_S)
    assert (await anna.post(f"{API}/grant")).status_code == 409
    assert await holder(anna) == "anna"


@pytest.mark.parametrize(("how", "leaver"), in_turn(WAYS_TO_LEAVE, LEAVERS))
async def test_nothing_is_granted_by_or_to_one_who_has_left(
    house: House,
    anna: httpx.AsyncClient,
    ben: httpx.AsyncClient,
    leaver: Leaver,
    how: str,
) -> None:
    name, refused, then = leaver
    await ben.post(f"{API}/request")
    clients = {"anna": anna, "ben": ben}
    await withdraw(house, how, name, clients.pop(name))
    assert (await anna.post(f"{API}/grant")).status_code in refused
    (stays,) = clients.values()
    shown = (await stays.get(API)).json()
    assert (shown["holder"], shown["request"]) == (then, None)


async def test_requests_without_end_disturb_six_times_and_keep_no_one_else_from_one(
    house: House, anna: httpx.AsyncClient, ben: httpx.AsyncClient
) -> None:
    program = await house.program(Role.OPERATOR)
    sent = [(await program.post(f"{API}/request")).status_code for _ in range(20)]
    assert set(sent) == {200}
    await program.delete(f"{API}/request")
    refused = 0
    while refused < 20:
        response = await program.post(f"{API}/request")
        refused += response.status_code == 429
        await program.delete(f"{API}/request")
    assert response.headers["Retry-After"]
    assert response.headers["RateLimit-Remaining"] == "0"
    requested = await house.events("control")
    assert len([each for each in requested if "request" in each["what"]]) <= 2 * MAX_REQUESTS
    assert (await ben.post(f"{API}/request")).status_code == 200
    assert await holder(anna) == "anna"


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
    assert (await program.post(f"{API}/take")).status_code == 200
    assert (await program.post(f"{API}/release")).status_code == 200
    account = (await house.events("control"))[0]["who"] + " (token)"
    use_up(house.services[ActLimit], account)
    assert (await program.post(f"{API}/take")).status_code == 429
    assert len(await house.events("control")) == 2
    assert (await program.get(f"{API}")).status_code == 200
    assert (await ben.post(f"{API}/take")).status_code == 200


async def test_pages_acknowledgements_and_commands_are_not_refused(house: House) -> None:
    engineer = await house.signed_in(Role.ENGINEER, "eva")
    use_up(house.services[ActLimit], "eva")
    assert (await engineer.get(f"/units/{BUS}/1")).status_code == 200
    absent = await engineer.post("/api/v1/alarms/none.1/acknowledge", json={})
    assert absent.status_code != 429, "an acknowledgement is bounded by the alarms, and nothing delays it"
    speed = await engineer.post(f"/api/v1/buses/{BUS}/units/1/speed", json={"raw": 100})
    assert speed.status_code != 429, "a command is bounded by the wire"
