"""Users stay signed in while the database is away; no one else signs in but by a break-glass account."""

from __future__ import annotations

import stat
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from app.alarms.monitor.line_alarms import LineAlarms
from app.audit.log import EventLog
from app.auth.accounts import Accounts
from app.auth.rights.known import KnownCredentials, _read
from app.auth.sign_in.break_glass import ENDS_AFTER_S, BreakGlass, path_in, read_accounts
from app.auth.sign_in.break_glass_book import BreakGlassBook
from app.database import Database
from app.errors import StoreError
from app.web.admission.access import Role
from bus.errors import CallerError
from bus.instants import UnixTime, unix_now
from tests import fork_server
from tests.administrator import BY
from tests.app.away_store import AwayDatabase, away_house
from tests.app.complete_app import PASSWORD, House

SECRET = "glass behind a hammer"


class Plant:
    """The app, and its database."""

    def __init__(self, house: House, database: AwayDatabase) -> None:
        self.house = house
        self.database = database

    async def leave(self) -> None:
        """A second after all that was done before."""
        known = self.house.services[KnownCredentials]
        known._sessions, known._tokens = await self.database.read(_read)
        self.database.leave()

    @property
    def book(self) -> BreakGlassBook:
        services = self.house.services
        data = services.settings.server.data
        return BreakGlassBook(data, services[Accounts], services[EventLog], "Mill 7")

    async def sign_in(self, name: str, secret: str) -> tuple[httpx.Response, httpx.AsyncClient]:
        client = self.house.client()
        return await client.post("/login", data={"name": name, "password": secret}), client


@pytest.fixture
async def plant(tmp_path: Path) -> AsyncIterator[Plant]:
    async with away_house(tmp_path) as (house, database):
        yield Plant(house, database)
        if database.is_away:
            await database.come_back()


async def test_users_stay_signed_in(plant: Plant) -> None:
    user = await plant.house.signed_in(Role.OPERATOR)
    program = await plant.house.program(Role.VIEWER)
    await plant.leave()
    page = await user.get("/", headers={"accept": "text/html"})
    assert "The database is away since" in page.text
    assert (await program.get("/api/v1/line")).status_code == 200
    unknown = plant.house.client(Authorization="Bearer made-up")
    assert (await unknown.get("/api/v1/line")).status_code == 503
    stranger = plant.house.client(Cookie="lineside_session=made-up")
    assert (await stranger.get("/api/v1/line")).status_code == 401
    await plant.database.come_back()
    page = await user.get("/", headers={"accept": "text/html"})
    assert "The database is away since" not in page.text


async def test_a_right_that_was_withdrawn_before_stays_withdrawn(plant: Plant) -> None:
    accounts = plant.house.services[Accounts]
    disabled = await plant.house.signed_in(Role.OPERATOR, "dan")
    lowered = await plant.house.signed_in(Role.ENGINEER, "lee")
    program = await plant.house.program(Role.VIEWER)
    await accounts.set_disabled("dan", True, **BY)
    await accounts.set_role("lee", Role.VIEWER, **BY)
    await accounts.revoke_token("key-viewer", **BY)
    await plant.leave()
    assert (await disabled.get("/api/v1/line")).status_code == 401
    assert (await program.get("/api/v1/line")).status_code == 503
    refused = await lowered.post("/api/v1/buses/dry-end/units/1/speed", json={"raw": 0})
    assert refused.status_code == 403


async def test_a_sign_out_holds_at_once_and_when_the_database_is_back(plant: Plant) -> None:
    user = await plant.house.signed_in(Role.OPERATOR, "ann")
    cookie = user.cookies["lineside_session"]
    await plant.leave()
    assert (await user.post("/logout")).status_code == 303
    kept = plant.house.client(Cookie=f"lineside_session={cookie}")
    assert (await kept.get("/api/v1/line")).status_code == 401
    await plant.database.come_back()
    assert (await kept.get("/api/v1/line")).status_code == 401
    [event] = await plant.house.events("logout")
    assert (event["who"], event["entered_at"] is not None) == ("ann", True)


async def test_without_an_account_no_one_signs_in_and_reads_why(plant: Plant) -> None:
    await plant.house.add("ann", Role.OPERATOR)
    await plant.leave()
    response, _ = await plant.sign_in("ann", PASSWORD)
    assert response.status_code == 503
    assert "no break-glass account" in response.text


async def test_a_break_glass_account_signs_in_only_while_the_database_is_away(plant: Plant) -> None:
    await plant.book.put("spare", "operator", SECRET, **BY)
    [made] = await plant.house.events("user")
    assert made["what"] == "break-glass account spare made, role operator"
    response, _ = await plant.sign_in("spare", SECRET)
    assert response.status_code == 401
    await plant.leave()
    response, client = await plant.sign_in("spare", SECRET)
    assert response.status_code == 303
    assert (await client.get("/api/v1/line")).status_code == 200
    assert (await client.get("/users")).status_code == 403
    assert (await client.get("/account")).status_code == 200
    plant.house.services[LineAlarms].site.tick()
    present = {alarm.definition.code for alarm in plant.house.services[LineAlarms].present()}
    assert "break_glass_used" in present
    await plant.database.come_back()
    [used] = [event for event in await plant.house.events("login") if event["who"] == "spare"]
    assert used["what"] == "signed in by a break-glass account, as operator"
    glass = plant.house.services[BreakGlass]
    glass._clock = lambda: UnixTime(unix_now() + ENDS_AFTER_S + 1)
    assert (await client.get("/api/v1/line")).status_code == 401


async def test_who_guesses_waits_and_is_logged(plant: Plant) -> None:
    await plant.book.put("spare", "engineer", SECRET, **BY)
    await plant.leave()
    codes = [(await plant.sign_in("spare", "wrong but long enough"))[0].status_code for _ in range(7)]
    assert codes[:5] == [401] * 5
    assert codes[-1] == 429
    assert (await plant.sign_in("nobody", SECRET))[0].status_code == 401
    await plant.database.come_back()
    refused = await plant.house.events("login_refused")
    assert {event["who"] for event in refused} == {"spare"}
    assert len(refused) >= 5


async def test_a_removed_account_is_gone(plant: Plant) -> None:
    await plant.book.put("spare", "operator", SECRET, **BY)
    await plant.book.remove("spare", **BY)
    with pytest.raises(CallerError):
        await plant.book.remove("spare", **BY)
    await plant.leave()
    assert (await plant.sign_in("spare", SECRET))[0].status_code == 503


@pytest.mark.parametrize(
    ("name", "role", "secret"),
    [
        ("spare", "admin", SECRET),
        ("spare", "viewer", SECRET),
        ("spare", "operator", "short"),
        ("ann", "operator", SECRET),
        ("ANN", "operator", SECRET),
        ("no blanks", "operator", SECRET),
    ],
)
async def test_what_makes_no_account(plant: Plant, name: str, role: str, secret: str) -> None:
    await plant.house.add("ann", Role.OPERATOR)
    with pytest.raises(CallerError):
        await plant.book.put(name, role, secret, **BY)
    assert read_accounts(path_in(plant.house.services.settings.server.data)) == {}


async def test_the_file_is_for_the_server_alone(plant: Plant) -> None:
    await plant.book.put("spare", "operator", SECRET, **BY)
    path = path_in(plant.house.services.settings.server.data)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert SECRET not in path.read_text()
    path.chmod(0o644)
    with pytest.raises(StoreError, match="others can read"):
        read_accounts(path)
    path.unlink()
    path.symlink_to("/dev/zero")
    with pytest.raises(StoreError):
        read_accounts(path)
    assert plant.house.services[Database] is plant.database


def test_the_command_line_makes_and_removes_an_account(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text('[server]\ndata = "./data"\n')
    call = ["user", "break-glass", "spare", "--config", str(config)]
    made = fork_server.run(*call, "--password-stdin", text=f"{SECRET}\n")
    assert made.returncode == 0, made.stderr
    [account] = read_accounts(path_in(tmp_path / "data")).values()
    assert (account.name, account.role) == ("spare", Role.OPERATOR)
    wrong = fork_server.run(*call, "--role", "admin", "--password-stdin", text=f"{SECRET}\n")
    assert wrong.returncode == 2
    assert fork_server.run(*call, "--remove").returncode == 0
    assert read_accounts(path_in(tmp_path / "data")) == {}
