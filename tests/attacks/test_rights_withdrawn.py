"""Restores and swaps go on after their request: when their rights are withdrawn, they stop."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.store import SetStore
from app.engineering.swap.service import SwapService
from app.people.auth.accounts import Accounts
from bus.catalogue.parameters import PARAMETERS
from tests.administrator import BY
from tests.app.complete_app import House
from tests.app.fake_worker import until
from tests.app.played_line import BUS, PlayedLine
from tests.attacks.withdrawals import ENGINEER, by_another_process, withdraw

ROWS = 12
STOPPED_AFTER = 4


async def planned(client: httpx.AsyncClient, line: PlayedLine) -> dict[str, Any]:
    """A restore of ROWS rows for unit 2."""
    taken = await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [2]})
    assert taken.status_code == 201, taken.text
    numbers = [number for number in PARAMETERS if number not in (8, 17, 18, 19, 20, 21, 27, 37)][:ROWS]
    for number in numbers:
        line.memory[2][number] += 1
    plan = await client.post(f"/api/v1/buses/{BUS}/units/2/restores", json={"set": taken.json()["id"]})
    assert plan.status_code == 201, plan.text
    assert len(plan.json()["rows"]) == ROWS
    return dict(plan.json())


async def ended(house: House, restore: str) -> dict[str, Any]:
    found = await house.services[RestoreService].find(restore)
    assert found is not None
    await until(lambda: found.state in ("equal", "different", "stopped"), "the end of the restore")
    await until(lambda: found.who, "its account")
    boss = await house.program(Role.ADMIN)
    return dict((await boss.get(f"/api/v1/restores/{restore}")).json())


@pytest.mark.parametrize(
    ("how", "cause"),
    [
        ("disabled", "the user was removed or disabled"),
        ("demoted", "the role was lowered"),
        ("another password", "the password was changed"),
        ("made again", "the password was changed"),
        ("removed by another process", "the user was removed or disabled"),
    ],
)
async def test_a_restore_stops_between_two_rows(house: House, line: PlayedLine, how: str, cause: str) -> None:
    client = await house.signed_in(Role.ENGINEER)
    plan = await planned(client, line)

    async def before(writes: int) -> None:
        if writes == STOPPED_AFTER - 1:
            await withdraw(house, how)

    line.before_write = before
    assert (await client.post(f"/api/v1/restores/{plan['id']}/start")).status_code == 202
    end = await ended(house, plan["id"])
    assert (end["state"], end["cause_code"]) == ("stopped", "rights_withdrawn")
    assert end["cause"]["detail"].startswith(f"rights withdrawn: {cause}")
    assert [row["outcome"] for row in end["rows"]] == (
        ["verified"] * STOPPED_AFTER + ["not_sent"] * (ROWS - STOPPED_AFTER)
    )
    assert len(line.written) == STOPPED_AFTER
    [event, *_] = await house.events("restore")
    assert (event["outcome"], event["who"]) == ("stopped", ENGINEER)
    assert cause in event["message"]


@pytest.mark.parametrize("how", ["revoked by another process", "expired", "created again"])
async def test_a_restore_under_a_token_ends_with_the_token(house: House, line: PlayedLine, how: str) -> None:
    client = await house.program(Role.ENGINEER)
    plan = await planned(client, line)
    accounts, of_token = house.services[Accounts], "WHERE name = 'key-engineer'"

    async def before(writes: int) -> None:
        if writes == 0 and how == "created again":
            await accounts.revoke_token("key-engineer", **BY)
            await accounts.create_token("key-engineer", Role.ENGINEER, **BY)
        elif writes == 0:
            change = "UPDATE tokens SET expires_at = 1.0" if how == "expired" else "DELETE FROM tokens"
            await by_another_process(house, f"{change} {of_token}")

    line.before_write = before
    await client.post(f"/api/v1/restores/{plan['id']}/start")
    end = await ended(house, plan["id"])
    assert end["cause"]["detail"].startswith("rights withdrawn: the token was revoked or has expired")
    assert len(line.written) == 1


async def test_users_who_keep_their_rights_are_not_affected(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ENGINEER)
    plan = await planned(client, line)

    async def before(writes: int) -> None:
        if writes == 1:
            await house.services[Accounts].set_role(ENGINEER, Role.ADMIN, **BY)
            await house.add("somebody-else", Role.ENGINEER)
            await house.services[Accounts].remove_user("somebody-else", **BY)

    line.before_write = before
    await client.post(f"/api/v1/restores/{plan['id']}/start")
    assert (await ended(house, plan["id"]))["state"] == "equal"


async def swap_begun(client: httpx.AsyncClient, line: PlayedLine) -> None:
    """A swap of unit 2, with a spare that differs in two rows from the set that it is restored from."""
    line.memory[2] |= {6: 20, 7: 30}
    taken = await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [2]})
    line.memory[2] |= {6: 0, 7: 0}
    begun = await client.post(f"/swap/{BUS}/2", data={"source": f"set:{taken.json()['id']}:2"})
    assert begun.status_code == 303, begun.text


async def test_the_restore_of_a_swap_stops_and_the_swap_is_not_verified(
    house: House, line: PlayedLine
) -> None:
    client = await house.signed_in(Role.ENGINEER)
    await swap_begun(client, line)
    planned = await client.post(f"/swap/{BUS}/2/restore")
    restore = planned.headers["location"].rpartition("/")[2]

    async def before(_: int) -> None:
        await withdraw(house, "disabled")

    line.before_write = before
    form = {"row": ["6", "7"]}
    assert (await client.post(f"/restores/{restore}/start", data=form)).status_code == 303
    end = await ended(house, restore)
    assert (end["state"], end["cause_code"]) == ("stopped", "rights_withdrawn")
    assert [row["outcome"] for row in end["rows"]] == ["verified", "not_sent"]
    swap = house.services[SwapService].find(BUS, 2)
    assert swap is not None
    assert not swap.proven


async def test_a_swap_from_the_sheet_is_not_verified_for_a_user_removed_meanwhile(
    house: House, line: PlayedLine
) -> None:
    client = await house.signed_in(Role.ENGINEER)
    assert (await client.post(f"/swap/{BUS}/2", data={"source": "sheet"})).status_code == 303

    async def before(_: int) -> None:
        await withdraw(house, "removed")

    line.before_read = before
    response = await client.post(f"/swap/{BUS}/2/entered")
    assert response.status_code == 403
    swap = house.services[SwapService].find(BUS, 2)
    assert swap is not None
    assert not swap.proven
    assert await house.services[SetStore].summaries(BUS, 2) == []
