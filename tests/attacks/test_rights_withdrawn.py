"""Work that goes on after its request: the rights under which it began are withdrawn, and it stops."""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.web.access import Role
from bus.catalogue.parameters import PARAMETERS
from tests.app.played_line import BUS, PlayedLine, played_line
from tests.app.whole_app import PASSWORD, House, whole_app

ENGINEER = "the-engineer"
ROWS = 12
STOPPED_AFTER = 4
Withdraw = Callable[[House, Path], Awaitable[None]]


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with whole_app(tmp_path) as house:
        await house.add("boss", Role.ADMIN)
        yield house


@pytest.fixture
async def line(house: House) -> PlayedLine:
    return await played_line(house.services)


async def until(condition: Callable[[], object], what: str) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end, f"never: {what}"
        await asyncio.sleep(0.005)


async def disabled(house: House, _: Path) -> None:
    await house.services.accounts.set_disabled(ENGINEER, True, by="boss", origin="test")


async def removed(house: House, _: Path) -> None:
    await house.services.accounts.remove_user(ENGINEER, by="boss", origin="test")


async def demoted(house: House, _: Path) -> None:
    await house.services.accounts.set_role(ENGINEER, Role.OPERATOR, by="boss", origin="test")


async def given_another_password(house: House, _: Path) -> None:
    await house.services.accounts.set_password(ENGINEER, "x" + PASSWORD, by="boss", origin="test")


async def replaced_by_a_namesake(house: House, _: Path) -> None:
    await removed(house, _)
    await house.add(ENGINEER, Role.ENGINEER)


async def disabled_by_another_process(house: House, folder: Path) -> None:
    _in_another_process(folder, f"UPDATE users SET disabled = 1 WHERE name = '{ENGINEER}'")
    await _noticed(house)


async def removed_by_another_process(house: House, folder: Path) -> None:
    _in_another_process(folder, f"DELETE FROM users WHERE name = '{ENGINEER}'")
    await _noticed(house)


def _in_another_process(folder: Path, change: str) -> None:
    """As the command line does: by a connection that the server knows nothing of."""
    with closing(sqlite3.connect(folder / "data" / "lineside.db", timeout=20)) as store:
        store.execute(change)
        store.commit()


async def _noticed(house: House) -> None:
    """The server looks at the store by itself."""
    noticed = asyncio.Event()

    async def notice(_: str) -> None:
        noticed.set()

    house.services.rights.on_withdrawn(notice)
    async with asyncio.timeout(20):
        await noticed.wait()


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
    found = await house.services.restores.find(restore)
    assert found is not None
    await until(lambda: found.ended, "the end of the restore")
    await until(lambda: found.who, "its account")
    boss = await house.program(Role.ADMIN)
    return dict((await boss.get(f"/api/v1/restores/{restore}")).json())


@pytest.mark.parametrize(
    ("withdraw", "cause"),
    [
        (disabled, "rights withdrawn: the user was removed or disabled"),
        (removed, "rights withdrawn: the user was removed or disabled"),
        (demoted, "rights withdrawn: the role was lowered"),
        (given_another_password, "rights withdrawn: the password was changed"),
        (replaced_by_a_namesake, "rights withdrawn: the password was changed"),
        (disabled_by_another_process, "rights withdrawn: the user was removed or disabled"),
        (removed_by_another_process, "rights withdrawn: the user was removed or disabled"),
    ],
)
async def test_a_restore_stops_between_two_rows(
    house: House, line: PlayedLine, tmp_path: Path, withdraw: Withdraw, cause: str
) -> None:
    client = await house.signed_in(Role.ENGINEER)
    plan = await planned(client, line)

    async def before(writes: int) -> None:
        if writes == STOPPED_AFTER - 1:
            await withdraw(house, tmp_path)

    line.before_write = before
    assert (await client.post(f"/api/v1/restores/{plan['id']}/start")).status_code == 202
    end = await ended(house, plan["id"])
    assert (end["state"], end["cause_code"]) == ("stopped", "rights_withdrawn")
    assert end["cause"].startswith(cause)
    assert [row["outcome"] for row in end["rows"]] == (
        ["verified"] * STOPPED_AFTER + ["not_sent"] * (ROWS - STOPPED_AFTER)
    )
    assert len(line.written) == STOPPED_AFTER
    [event, *_] = await house.events("restore")
    assert (event["outcome"], event["who"]) == ("stopped", ENGINEER)
    assert cause in event["message"]


@pytest.mark.parametrize("how", ["revoked", "revoked by another process", "expired", "created again"])
async def test_a_restore_under_a_token_ends_with_the_token(
    house: House, line: PlayedLine, tmp_path: Path, how: str
) -> None:
    client = await house.program(Role.ENGINEER)
    plan = await planned(client, line)
    accounts = house.services.accounts

    async def before(writes: int) -> None:
        if writes != 0:
            return
        if how in ("revoked", "created again"):
            await accounts.revoke_token("key-engineer", by="boss", origin="test")
        if how == "created again":
            await accounts.create_token("key-engineer", Role.ENGINEER, by="boss", origin="test")
        if how == "revoked by another process":
            _in_another_process(tmp_path, "DELETE FROM tokens WHERE name = 'key-engineer'")
            await _noticed(house)
        if how == "expired":
            _in_another_process(tmp_path, "UPDATE tokens SET expires_at = 1.0 WHERE name = 'key-engineer'")
            await _noticed(house)

    line.before_write = before
    await client.post(f"/api/v1/restores/{plan['id']}/start")
    end = await ended(house, plan["id"])
    assert end["cause"].startswith("rights withdrawn: the token was revoked or has expired")
    assert len(line.written) == 1


async def test_whoever_keeps_the_rights_is_not_disturbed(house: House, line: PlayedLine) -> None:
    client = await house.signed_in(Role.ENGINEER)
    plan = await planned(client, line)

    async def before(writes: int) -> None:
        if writes == 1:
            await house.services.accounts.set_role(ENGINEER, Role.ADMIN, by="boss", origin="test")
            await house.add("somebody-else", Role.ENGINEER)
            await house.services.accounts.remove_user("somebody-else", by="boss", origin="test")

    line.before_write = before
    await client.post(f"/api/v1/restores/{plan['id']}/start")
    assert (await ended(house, plan["id"]))["state"] == "equal"


async def test_a_batch_stops_between_two_units(house: House, line: PlayedLine, tmp_path: Path) -> None:
    client = await house.signed_in(Role.ENGINEER)
    form = {"number": "6", "unit-1": "2.0", "unit-2": "3.0", "was-1": "0", "was-2": "0"}
    assert (await client.get(f"/batch/{BUS}?number=6")).status_code == 200

    async def before(_: int) -> None:
        await disabled(house, tmp_path)

    line.before_write = before
    answer = await client.post(f"/batch/{BUS}/write", data=form)
    assert answer.status_code == 200, answer.text
    assert "rights withdrawn" in answer.text
    assert line.written == [(1, 6, 20)]


async def test_a_set_is_not_kept_for_somebody_who_was_removed_meanwhile(
    house: House, line: PlayedLine, tmp_path: Path
) -> None:
    client = await house.signed_in(Role.ENGINEER)

    async def before(unit: int) -> None:
        if unit == 2:
            await removed(house, tmp_path)

    line.before_read = before
    begun = await client.post("/sets/take", data={"bus": BUS, "name": "mine"})
    assert begun.status_code == 303
    taking = house.services.takings.get(begun.headers["location"].rpartition("/")[2])
    assert taking is not None
    await until(lambda: taking.state != "reading", "the end of the reading")
    assert (taking.state, taking.set_id) == ("failed", None)
    assert taking.cause.startswith("rights withdrawn")


async def test_a_token_that_another_process_revokes_loses_control_of_the_line(tmp_path: Path) -> None:
    async with whole_app(tmp_path, control=True) as house:
        client = await house.program(Role.ENGINEER)
        await played_line(house.services)
        assert (await client.post(f"/api/v1/buses/{BUS}/control")).status_code == 200
        assert house.services.safeguards.holder(BUS) == "key-engineer (token)"
        _in_another_process(tmp_path, "DELETE FROM tokens WHERE name = 'key-engineer'")
        await until(lambda: house.services.safeguards.holder(BUS) == "", "control released")
        [event, *_] = await house.events("control")
        assert (event["what"], event["old"]) == ("control given back", "key-engineer (token)")


async def test_a_change_of_the_baud_rate_is_given_up(house: House, line: PlayedLine, tmp_path: Path) -> None:
    client = await house.signed_in(Role.ENGINEER)
    asked = asyncio.create_task(
        client.post(f"/api/v1/buses/{BUS}/baud", json={"baud": 4800, "confirm": True, "timeout_s": 20})
    )
    await until(lambda: line.held, "the command on its way")
    await disabled(house, tmp_path)
    await until(lambda: line.cancelled, "the command given up")
    assert line.cancelled == [line.held[0].id]
    asked.cancel()
