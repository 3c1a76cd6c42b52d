"""Signing in, sessions that end, tokens, and what is noted of it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from app.audit.log import EventLog
from app.audit.store import Filter
from app.auth import rules
from app.auth.accounts import Accounts
from app.auth.failures import PER_NAME, WINDOW_S
from app.auth.passwords import Passwords
from app.auth.signin import SignIn
from app.database import Database
from app.errors import Problem
from app.web.access import Role

PASSWORD = "correct horse"
OWN = {"dry-end": "token-of-dry-end", "wet-end": "token-of-wet-end"}


class House:
    """Sign-in and accounts over one store, with a clock that is set by hand."""

    def __init__(self, database: Database) -> None:
        self.now = 1_000_000.0
        self.database = database
        self.passwords = Passwords()
        self.log = EventLog(database, lambda: self.now)
        self.accounts = Accounts(database, self.passwords, self.log, lambda: self.now, buses=OWN)
        self.sign_in = SignIn(database, self.passwords, self.log, OWN, lambda: self.now)

    async def add(self, name: str = "ann", role: Role = Role.OPERATOR) -> None:
        await self.accounts.add_user(name, role, PASSWORD, by="t", origin="t")

    async def enter(self, name: str = "ann", password: str = PASSWORD, address: str = "a") -> str:
        return await self.sign_in.sign_in(name, password, address)

    async def refused(self, name: str = "ann", password: str = "wrong", address: str = "a") -> int:
        with pytest.raises(Problem) as caught:
            await self.enter(name, password, address)
        return caught.value.status

    async def log_of(self, kind: str) -> list[tuple[str, str]]:
        found, _ = await self.log.page(Filter(kind=kind), 100)
        return [(event["who"], event["origin"]) for event in reversed(found)]


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    database = Database(tmp_path / "lineside.db")
    house = House(database)
    yield house
    house.passwords.close()
    database.close()


async def test_the_right_password_opens_a_session(house: House) -> None:
    await house.add()
    person = await house.sign_in.by_cookie(await house.enter())
    assert person is not None
    assert (person.name, person.role, person.via) == ("ann", Role.OPERATOR, "session")
    assert await house.log_of("login") == [("ann", "a")]


async def test_neither_password_nor_cookie_nor_token_is_stored(house: House) -> None:
    await house.add()
    cookie = await house.enter()
    token = await house.accounts.create_token("t", Role.VIEWER, by="t", origin="t")
    house.database.close()
    stored = b"".join(path.read_bytes() for path in house.database.path.parent.iterdir() if path.is_file())
    for secret in (PASSWORD, cookie, token):
        assert secret.encode() not in stored


@pytest.mark.parametrize(
    ("name", "password"), [("ann", "wrong"), ("nobody", PASSWORD), ("ann", ""), ("", "")]
)
async def test_a_wrong_one_is_refused_without_saying_which(house: House, name: str, password: str) -> None:
    await house.add()
    with pytest.raises(Problem) as caught:
        await house.enter(name, password)
    assert (caught.value.status, caught.value.detail) == (401, "the name or the password is not right")


async def test_refusals_are_events_and_never_hold_what_may_be_a_password(house: House) -> None:
    await house.add()
    await house.refused()
    await house.refused(name="my-Passw0rd-in-the-wrong-field")
    assert await house.log_of("login_refused") == [("ann", "a"), ("unknown name", "a")]


async def test_too_many_failures_are_refused_unheard_even_with_the_right_password(house: House) -> None:
    await house.add()
    assert [await house.refused(address=f"a{n}") for n in range(PER_NAME)] == [401] * PER_NAME
    assert await house.refused(password=PASSWORD, address="b") == 429
    house.now += WINDOW_S
    await house.enter()


async def test_a_session_that_is_not_used_ends(house: House) -> None:
    await house.add()
    cookie = await house.enter()
    house.now += rules.PERSON_LIFETIME.idle_s - 1
    assert await house.sign_in.by_cookie(cookie)
    house.now += rules.PERSON_LIFETIME.idle_s - 1
    assert await house.sign_in.by_cookie(cookie), "it was used since"
    house.now += rules.PERSON_LIFETIME.idle_s
    assert await house.sign_in.by_cookie(cookie) is None


async def test_even_one_in_use_ends_some_day(house: House) -> None:
    await house.add()
    cookie = await house.enter()
    end = house.now + rules.PERSON_LIFETIME.whole_s
    while house.now < end:
        assert await house.sign_in.by_cookie(cookie)
        house.now += rules.PERSON_LIFETIME.idle_s / 2
    assert await house.sign_in.by_cookie(cookie) is None


async def test_signing_out_ends_this_session_only(house: House) -> None:
    await house.add()
    one, other = await house.enter(), await house.enter()
    person = await house.sign_in.by_cookie(one)
    assert person is not None
    await house.sign_in.sign_out(one, person, "a")
    assert await house.sign_in.by_cookie(one) is None
    assert await house.sign_in.by_cookie(other)


@pytest.mark.parametrize("ending", ["password", "disable", "remove"])
async def test_what_ends_every_session_of_somebody(house: House, ending: str) -> None:
    await house.add()
    cookie = await house.enter()
    match ending:
        case "password":
            await house.accounts.set_password("ann", "another one", by="t", origin="t")
        case "disable":
            await house.accounts.set_disabled("ann", True, by="t", origin="t")
        case "remove":
            await house.accounts.remove_user("ann", by="t", origin="t")
    assert await house.sign_in.by_cookie(cookie) is None
    assert await house.refused(password=PASSWORD) == 401


async def test_a_new_role_counts_at_once(house: House) -> None:
    await house.add()
    cookie = await house.enter()
    await house.accounts.set_role("ann", Role.VIEWER, by="t", origin="t")
    person = await house.sign_in.by_cookie(cookie)
    assert person is not None
    assert person.role is Role.VIEWER


async def test_a_panel_signs_in_by_its_pin_and_there_only(house: House) -> None:
    await house.accounts.add_panel("p1", Role.VIEWER, "4711", "/units/a/1", by="t", origin="t")
    await house.add()
    cookie = await house.sign_in.sign_in("p1", "4711", "a", panel=True)
    person = await house.sign_in.by_cookie(cookie)
    assert person is not None
    assert (person.panel, person.role, person.home) == (True, Role.VIEWER, "/units/a/1")
    assert await house.refused("p1", "4711") == 401
    with pytest.raises(Problem):
        await house.sign_in.sign_in("ann", PASSWORD, "a", panel=True)
    house.now += 30 * rules.DAY
    assert await house.sign_in.by_cookie(cookie), "a panel stays signed in"


async def test_tokens(house: House) -> None:
    token = await house.accounts.create_token("plc", Role.ENGINEER, by="ann", origin="t")
    person = await house.sign_in.by_token(token)
    assert person is not None
    assert (person.name, person.role, person.via) == ("plc", Role.ENGINEER, "token")
    assert (await house.accounts.tokens())[0].used_at == house.now
    await house.accounts.revoke_token("plc", by="ann", origin="t")
    assert await house.sign_in.by_token(token) is None


@pytest.mark.parametrize("bearer", ["", "x", "ü", "x" * 10_000])
async def test_what_is_no_token(house: House, bearer: str) -> None:
    assert await house.sign_in.by_token(bearer) is None


@pytest.mark.parametrize("bus", OWN)
async def test_each_of_the_servers_own_workers_has_a_token_for_its_bus(house: House, bus: str) -> None:
    person = await house.sign_in.by_token(OWN[bus])
    assert person is not None
    assert (person.role, person.via, person.bus) == (Role.WORKER, "worker", bus)


async def test_a_workers_token_names_its_bus(house: House) -> None:
    token = await house.accounts.create_token("w", Role.WORKER, bus="dry-end", by="ann", origin="t")
    person = await house.sign_in.by_token(token)
    assert person is not None
    assert (person.role, person.via, person.bus) == (Role.WORKER, "token", "dry-end")


async def test_a_token_expires_and_says_so_to_who_holds_it(house: House) -> None:
    token = await house.accounts.create_token("plc", Role.VIEWER, expires_days=30, by="ann", origin="t")
    house.now += 30 * rules.DAY - 1
    assert await house.sign_in.by_token(token)
    house.now += 1
    with pytest.raises(Problem) as caught:
        await house.sign_in.by_token(token)
    assert (caught.value.status, caught.value.code) == (401, "unauthorized")
    assert caught.value.detail == "the token plc expired on 1970-02-11; an admin can create a new one"
    assert 'error="invalid_token"' in caught.value.headers["WWW-Authenticate"]


@pytest.fixture
def gone(house: House) -> list[str]:
    """Whoever is signed in nowhere any more, as it is told."""
    told: list[str] = []

    async def tell(name: str) -> None:
        told.append(name)

    house.sign_in.on_gone = tell
    return told


async def test_the_last_signing_out_is_told_and_no_other(house: House, gone: list[str]) -> None:
    await house.add()
    first, second = await house.enter(), await house.enter()
    for cookie, told in ((first, []), (second, ["ann"])):
        person = await house.sign_in.by_cookie(cookie)
        assert person is not None
        await house.sign_in.sign_out(cookie, person, "a")
        assert gone == told


async def test_a_session_that_is_over_is_told_once(house: House, gone: list[str]) -> None:
    await house.add()
    cookie = await house.enter()
    house.now += rules.PERSON_LIFETIME.idle_s + 1
    assert [await house.sign_in.by_cookie(cookie) for _ in range(2)] == [None, None]
    assert gone == ["ann"]
