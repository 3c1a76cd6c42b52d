"""What goes on after its request, or waits for the wire, stops when its rights are withdrawn."""

from __future__ import annotations

import asyncio
import time
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.web.access import Role
from app.engineering.recipes.book import RecipeBook
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.saving import SetReadings, SetSchedule
from app.engineering.sets.store import SetStore
from app.engineering.swap.service import SwapService
from app.line.commands.safeguards import Safeguards
from app.people.audit.log import EventLog, Filter, Logged
from app.people.auth.accounts import Accounts
from bus.catalogue.parameters import PARAMETERS
from tests.administrator import BY
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import until
from tests.app.played_line import BUS, PlayedLine, played_line
from tests.attacks.withdrawals import ENGINEER, by_another_process, in_another_process, withdraw

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


@pytest.mark.parametrize("how", ["demoted", "disabled by another process"])
async def test_a_batch_stops_between_two_units(house: House, line: PlayedLine, how: str) -> None:
    client = await house.signed_in(Role.ENGINEER)
    form = {"number": "6", "unit-1": "2.0", "unit-2": "3.0", "was-1": "0", "was-2": "0"}
    assert (await client.get(f"/batch/{BUS}?number=6")).status_code == 200

    async def before(_: int) -> None:
        await withdraw(house, how)

    line.before_write = before
    form |= {"id": "a-batch-of-two", "reviewed_at": str(time.time())}
    response = await client.post(f"/batch/{BUS}/write", data=form)
    assert response.status_code == 200, response.text
    assert "rights withdrawn" in response.text
    assert line.written == [(1, 6, 20)]


async def test_a_change_of_a_group_is_given_up(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ENGINEER)
    body = {"setpoints": {"1": {"raw": 10}, "2": {"raw": 20}}, "timeout_s": 20}
    pending = asyncio.create_task(client.post(f"/api/v1/buses/{BUS}/speeds", json=body))
    await until(lambda: line.held, "the command on its way")
    await withdraw(house, "disabled")
    await until(lambda: line.cancelled, "the command given up")
    line.end("not_sent")
    response = await pending
    assert (response.status_code, response.json()["code"]) == (503, "not_sent")
    assert "rights withdrawn: the user was removed or disabled" in response.json()["detail"]


async def test_a_recipe_is_given_up_and_does_not_count_as_loaded(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ENGINEER)
    for unit in (1, 2):
        line.memory[unit][2] = 20_000
        await client.get(f"/api/v1/buses/{BUS}/units/{unit}/parameters?refresh=true")
    recipe = {"name": "Thin", "setpoints": {"1": 10, "2": 20}}
    saved = await client.post(f"/api/v1/buses/{BUS}/recipes", json=recipe)
    assert saved.status_code == 201, saved.text
    load = f"/api/v1/recipes/{saved.json()['id']}/load"
    pending = asyncio.create_task(client.post(load, json={"confirm": True}))
    await until(lambda: line.held, "the command on its way")
    await withdraw(house, "demoted")
    await until(lambda: line.cancelled, "the command given up")
    line.end("not_sent")
    response = await pending
    assert "rights withdrawn: the role was lowered" in response.json()["detail"]
    assert house.services[RecipeBook].loaded(BUS) is None


async def test_a_schedule_outlives_who_made_it_and_only_reads(house: House, line: PlayedLine) -> None:
    """It belongs to the site, as a configuration does: its sets are read by the server itself."""
    client = await house.signed_in(Role.ENGINEER)
    wanted = {"minute_of_day": 0}
    assert (await client.put(f"/api/v1/buses/{BUS}/set-schedule", json=wanted)).status_code == 200
    await withdraw(house, "removed")
    now = datetime.now().astimezone()
    await house.services.buses[BUS][SetSchedule].save_due(now - timedelta(days=1), now)
    kept = await house.services[SetStore].summaries(BUS)
    assert {(one.who, one.origin) for one in kept} == {("server", "on schedule")}
    assert (line.written, line.held) == ([], [])
    refused = await client.put(f"/api/v1/buses/{BUS}/set-schedule", json={"minute_of_day": None})
    assert refused.status_code == 401


async def test_a_set_is_not_saved_for_a_user_removed_meanwhile(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ENGINEER)

    async def before(unit: int) -> None:
        if unit == 2:
            await withdraw(house, "removed")

    line.before_read = before
    begun = await client.post("/sets/take", data={"bus": BUS, "name": "mine"})
    assert begun.status_code == 303
    taking = house.services[SetReadings].get(begun.headers["location"].rpartition("/")[2])
    assert taking is not None
    await until(lambda: taking.state != "reading", "the end of the reading")
    assert (taking.state, taking.set_id) == ("failed", None)
    assert str(taking.cause).startswith("rights withdrawn")


async def test_a_token_that_another_process_revokes_loses_control_of_the_line(tmp_path: Path) -> None:
    async with complete_app(tmp_path, control=True) as house:
        client = await house.program(Role.ENGINEER)
        await played_line(house.services)
        assert (await client.post(f"/api/v1/buses/{BUS}/control")).status_code == 200
        assert house.services.buses[BUS][Safeguards].holder() == "key-engineer (token)"
        released: list[Logged] = []
        house.services[EventLog].subscribe(released.append)
        in_another_process(house, "DELETE FROM tokens WHERE name = 'key-engineer'")
        await until(lambda: released, "control released, on disk")
        assert house.services.buses[BUS][Safeguards].holder() == ""
        [event], _ = await house.services[EventLog].page(Filter(), 1)
        assert (event["what"], event["old"]) == ("control released", "key-engineer (token)")


async def test_a_write_that_ends_while_the_set_before_it_is_stored_is_an_event(
    house: House, line: PlayedLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The response was 403, and no event named the command."""
    client = await house.signed_in(Role.ENGINEER)
    await client.get(f"/api/v1/buses/{BUS}/units/1/parameters?refresh=true")
    store = house.services[SetStore]
    has_set_since = store.has_set_since

    async def withdrawn_meanwhile(bus: str, unit: int, since: float) -> bool:
        await withdraw(house, "disabled")
        return await has_set_since(bus, unit, since)

    monkeypatch.setattr(store, "has_set_since", withdrawn_meanwhile)
    response = await client.put(f"/api/v1/buses/{BUS}/units/1/parameters/6", json={"raw": 20})
    assert (response.status_code, response.json()["code"]) == (403, "rights_withdrawn")
    assert line.written == []
    [event] = await house.events("command")
    assert (event["who"], event["unit"], event["new_raw"]) == (ENGINEER, 1, 20)
    assert event["outcome"] == "rights_withdrawn"
    assert event["message"].startswith("rights withdrawn: the user was removed or disabled")
