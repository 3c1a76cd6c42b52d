"""The ways in which a person loses the right to what is under way."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing

import httpx

from app.core.web.access import Role
from app.people.auth.accounts import Accounts
from app.people.auth.rights import Rights
from tests.administrator import BY
from tests.app.complete_app import PASSWORD, House

ENGINEER = "the-engineer"


async def withdraw(
    house: House, how: str, name: str = ENGINEER, client: httpx.AsyncClient | None = None
) -> None:
    """Take the rights of the engineer, or of the operator of this name; ``client``: who may sign out."""
    accounts, is_engineer = house.services[Accounts], name == ENGINEER
    match how:
        case "signed out" if client is not None:
            await client.post("/logout")
        case "disabled" | "admitted again":
            await accounts.set_disabled(name, how == "disabled", **BY)
        case "demoted":
            await accounts.set_role(name, Role.OPERATOR if is_engineer else Role.VIEWER, **BY)
        case "another password":
            await accounts.set_password(name, f"x{PASSWORD}", **BY)
        case "removed" | "made again":
            await accounts.remove_user(name, **BY)
        case "disabled by another process":
            await by_another_process(house, f"UPDATE users SET disabled = 1 WHERE name = '{name}'")
        case "removed by another process":
            await by_another_process(house, f"DELETE FROM users WHERE name = '{name}'")
        case _:
            raise AssertionError(how)
    if how == "made again":
        await house.add(name, Role.ENGINEER if is_engineer else Role.OPERATOR)


async def by_another_process(house: House, change: str) -> None:
    """Change the store as the command line does; return once the server has checked it."""
    event = asyncio.Event()

    async def notice(_: str) -> None:
        event.set()

    house.services[Rights].on_withdrawn(notice)
    in_another_process(house, change)
    async with asyncio.timeout(60):
        await event.wait()


def in_another_process(house: House, change: str) -> None:
    """Change the store by a connection that the server knows nothing of."""
    with closing(sqlite3.connect(house.services.settings.server.data / "lineside.db", timeout=20)) as store:
        store.execute(change)
        store.commit()
