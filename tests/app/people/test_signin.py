"""Signing in, sessions that end, tokens, and what is noted of it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from argon2 import PasswordHasher, Type, extract_parameters

from app.core.database import Database
from app.core.web.access import Person, Role
from app.errors import Problem
from app.people.audit.log import EventLog, Filter
from app.people.auth import passwords, rules, store
from app.people.auth.accounts import Accounts
from app.people.auth.identify import Identity
from app.people.auth.rights import Rights
from app.people.auth.settings import Sessions
from app.people.auth.sign_in import (
    FIRST_WAIT_S,
    FREE,
    OF_NAME,
    OF_NAME_EVERY_S,
    SignedIn,
    SignIn,
    WrongSecretError,
)
from bus.errors import CallerError
from tests.administrator import BY

PASSWORD = "correct horse"
PIN = "471193"
LIFETIME = rules.lifetime(Sessions(), panel=False)
OWN = {"dry-end": "token-of-dry-end", "wet-end": "token-of-wet-end"}


class House:
    """Sign-in and accounts over one store, with clocks that are set by hand."""

    def __init__(self, database: Database) -> None:
        self.now, self.running = 1_000_000.0, 0.0
        self.database = database
        self.log = EventLog(database, lambda: self.now)
        self.accounts = Accounts(database, self.log, lambda: self.now, buses=OWN)
        self.rights = Rights(database, lambda: self.now, lambda: self.now)
        self.sign_in = SignIn(
            database, self.log, Sessions(), self.rights, lambda: self.now, lambda: self.running, site="Mill 7"
        )
        self.identity = Identity(database, self.sign_in, self.rights, OWN, lambda: self.now)

    async def add(self, name: str = "ann", role: Role = Role.OPERATOR) -> None:
        await self.accounts.add_user(name, role, PASSWORD, **BY)

    async def begin(self, name: str = "ann", address: str = "a", device: str = "") -> SignedIn:
        return await self.sign_in.sign_in(name, PASSWORD, address, device=device)

    async def enter(self, name: str = "ann", password: str = PASSWORD, address: str = "a") -> str:
        return (await self.sign_in.sign_in(name, password, address)).session

    async def refused(
        self, name: str = "ann", password: str = "wrong", address: str = "a", device: str = ""
    ) -> int:
        with pytest.raises(Problem) as caught:
            await self.sign_in.sign_in(name, password, address, device=device)
        if isinstance(caught.value, WrongSecretError):
            await self.sign_in.note_refusal(name, address)
        return caught.value.status

    async def log_of(self, kind: str) -> list[tuple[str, str]]:
        found, _ = await self.log.page(Filter(kind=kind), 100)
        return [(event["who"], event["origin"]) for event in reversed(found)]


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    database = Database(tmp_path / "lineside.db")
    house = House(database)
    yield house
    database.close()


async def test_the_right_password_opens_a_session(house: House) -> None:
    await house.add()
    person = await house.identity.by_cookie(await house.enter())
    assert person is not None
    assert (person.name, person.role, person.via) == ("ann", Role.OPERATOR, "session")
    assert await house.log_of("login") == [("ann", "a")]


async def test_neither_password_nor_cookie_nor_token_is_stored(house: House) -> None:
    await house.add()
    cookie = await house.enter()
    token = await house.accounts.create_token("t", Role.VIEWER, **BY)
    house.database.close()
    stored = b"".join(path.read_bytes() for path in house.database.path.parent.iterdir() if path.is_file())
    for secret in (PASSWORD, cookie, token):
        assert secret.encode() not in stored


async def test_a_wrong_one_is_refused_without_naming_which(house: House) -> None:
    await house.add()
    for name, password in (("ann", "wrong"), ("nobody", PASSWORD), ("ann", ""), ("", "")):
        with pytest.raises(Problem) as caught:
            await house.enter(name, password)
        assert (caught.value.status, caught.value.detail) == (401, "wrong name or password")


async def test_refusals_are_events_and_never_hold_what_may_be_a_password(house: House) -> None:
    await house.add()
    await house.refused()
    await house.refused(name="my-Passw0rd-in-the-wrong-field")
    assert await house.log_of("login_refused") == [("ann", "a"), ("unknown name", "a")]


async def test_each_wrong_guess_waits_longer_and_shows_how_long(house: House) -> None:
    await house.add()
    assert [await house.refused() for _ in range(FREE)] == [401] * FREE
    with pytest.raises(Problem) as caught:
        await house.enter()
    assert (caught.value.status, caught.value.code) == (429, "too_many")
    assert caught.value.headers == {
        "RateLimit-Limit": "1",
        "RateLimit-Remaining": "0",
        "RateLimit-Reset": "2",
        "Retry-After": "2",
    }
    house.running += FIRST_WAIT_S
    house.now -= 3600  # The wall clock is set back: the wait is no longer for that.
    assert await house.refused() == 401
    house.running += FIRST_WAIT_S
    assert await house.refused(password=PASSWORD) == 429
    house.running += FIRST_WAIT_S
    await house.enter()


async def test_a_user_is_not_locked_out_where_they_signed_in_before(house: House) -> None:
    """Ten wrong sign-ins from anywhere locked a named operator everywhere."""
    await house.add()
    await house.enter(address="192.0.2.7")
    for number in range(OF_NAME + 5):
        await house.refused(address=f"198.51.100.{number}")
    assert await house.refused(password=PASSWORD, address="203.0.113.5") == 429, "a stranger waits"
    await house.enter(address="192.0.2.7")
    house.running += OF_NAME_EVERY_S
    await house.enter(address="203.0.113.5")


async def test_a_known_browser_does_not_wait_for_who_shares_its_address(house: House) -> None:
    """Behind one proxy all clients have the same address."""
    await house.add()
    device = (await house.begin(address="proxy")).device
    for _ in range(FREE):
        await house.refused(address="proxy")
    assert await house.refused(password=PASSWORD, address="proxy") == 429
    assert (await house.begin(address="proxy", device=device)).device == device
    assert await house.refused(address="proxy", device="x" * 43) == 429, "of this browser nothing is known"


async def test_a_browser_is_known_for_the_names_that_signed_in_with_it(house: House) -> None:
    await house.add()
    await house.add("bob")
    device = (await house.begin("ann", "proxy")).device
    for _ in range(OF_NAME):
        await house.refused("bob", address="elsewhere", device=device)
        house.running += 60
    attempt = await house.sign_in._attempt("bob", "other", device, False)
    assert not attempt.own_browser


async def test_the_present_password_is_guessed_no_faster(house: House) -> None:
    await house.add()
    for _ in range(FREE):
        with pytest.raises(CallerError, match="wrong current password"):
            await house.sign_in.check_present("ann", "wrong", "a")
    with pytest.raises(Problem) as caught:
        await house.sign_in.check_present("ann", PASSWORD, "a")
    assert caught.value.status == 429
    await house.log.repeated.record_due(everything=True)
    found, _ = await house.log.page(Filter(kind="user"), 100)
    refused = [event for event in found if event["what"] == "password change refused"]
    assert [(event["who"], event["origin"], event["count"]) for event in refused] == [
        ("ann", "a", FREE - 1),
        ("ann", "a", None),
    ]


async def test_a_secret_that_todays_rules_refuse_works_and_is_noted(house: House) -> None:
    await house.add()
    hashed = await passwords.hash_secret("short")
    await house.database.write(lambda c: c.execute("UPDATE users SET secret_hash = ?", (hashed,)))
    await house.enter(password="short")
    assert (await house.accounts.users())[0].weak_secret
    await house.accounts.set_password("ann", PASSWORD, **BY)
    assert not (await house.accounts.users())[0].weak_secret
    await house.enter()
    assert not (await house.accounts.users())[0].weak_secret


SERVED = passwords._hasher
"""What a server hashes with. The session's fixture replaces it after this module was imported."""


def test_a_server_hashes_as_owasp_recommends() -> None:
    """Password Storage Cheat Sheet: Argon2id with 7 MiB, five iterations and one thread."""
    parameters = extract_parameters(SERVED.hash("secret"))
    assert parameters.type is Type.ID
    assert (parameters.memory_cost, parameters.time_cost, parameters.parallelism) == (7 * 1024, 5, 1)


EARLIER = PasswordHasher(time_cost=1, memory_cost=64, parallelism=1)
"""As an earlier version hashed, with other parameters than today's."""


async def stored_hash(house: House, name: str = "ann") -> str:
    found = await house.database.read(lambda c: store.user(c, name))
    assert found is not None
    return found[1]


async def hashed_by_an_earlier_version(house: House) -> str:
    """The password is the same, its hash another."""
    hashed = EARLIER.hash(PASSWORD)
    await house.database.write(lambda c: c.execute("UPDATE users SET secret_hash = ?", (hashed,)))
    return hashed


async def test_a_hash_of_an_earlier_version_is_replaced_at_the_next_sign_in(house: House) -> None:
    """A wrong guess took longer for it than for an unknown name, for as long as the password was kept."""
    await house.add()
    before = await hashed_by_an_earlier_version(house)
    assert await house.refused() == 401
    assert await stored_hash(house) == before
    await house.enter()
    after = await stored_hash(house)
    assert extract_parameters(after) == extract_parameters(await passwords.hash_secret("new"))
    await house.enter()
    assert await stored_hash(house) == after, "once is enough"


async def test_a_replaced_hash_withdraws_no_rights(house: House) -> None:
    """A user signs in on another device while their restore is under way."""
    await house.add()
    cookie = await house.enter()
    await hashed_by_an_earlier_version(house)
    person = await house.identity.by_cookie(cookie)
    assert person is not None
    await house.enter()
    await house.rights.check(person)
    assert await house.identity.by_cookie(cookie) == person
    await house.accounts.set_password("ann", "another good one", **BY)
    with pytest.raises(Problem, match="the password was changed"):
        await Rights(house.database).check(person)


async def test_a_password_that_was_changed_meanwhile_is_not_put_back(house: House) -> None:
    await house.add()
    before = await hashed_by_an_earlier_version(house)
    await house.accounts.set_password("ann", "another good one", **BY)
    changed = await stored_hash(house)
    await house.database.write(lambda c: store.replace_hash(c, "ann", before, "late"))
    assert await stored_hash(house) == changed


async def test_a_session_that_is_not_used_ends_and_even_one_in_use_some_day(house: House) -> None:
    await house.add()
    cookie = await house.enter()
    end = house.now + LIFETIME.absolute_s
    while house.now < end:
        assert await house.identity.by_cookie(cookie)
        house.now += LIFETIME.idle_s / 2
    assert await house.identity.by_cookie(cookie) is None
    cookie = await house.enter()
    house.now += LIFETIME.idle_s - 1
    assert await house.identity.by_cookie(cookie)
    house.now += LIFETIME.idle_s
    assert await house.identity.by_cookie(cookie) is None


@pytest.mark.parametrize("ending", ["password", "disable", "remove"])
async def test_changes_that_end_every_session_of_a_user(house: House, ending: str) -> None:
    await house.add()
    cookie = await house.enter()
    match ending:
        case "password":
            await house.accounts.set_password("ann", "another good one", **BY)
        case "disable":
            await house.accounts.set_disabled("ann", True, **BY)
        case "remove":
            await house.accounts.remove_user("ann", **BY)
    assert await house.identity.by_cookie(cookie) is None
    assert await house.refused(password=PASSWORD) == 401


async def test_a_new_role_counts_at_once(house: House) -> None:
    await house.add()
    cookie = await house.enter()
    await house.accounts.set_role("ann", Role.VIEWER, **BY)
    person = await house.identity.by_cookie(cookie)
    assert person is not None
    assert person.role is Role.VIEWER


async def test_a_panel_signs_in_by_its_pin_and_there_only(house: House) -> None:
    await house.accounts.add_panel("p1", Role.VIEWER, PIN, "/units/a/1", **BY)
    await house.add()
    cookie = (await house.sign_in.sign_in("p1", PIN, "a", panel=True)).session
    person = await house.identity.by_cookie(cookie)
    assert person is not None
    assert (person.panel, person.role, person.home) == (True, Role.VIEWER, "/units/a/1")
    assert await house.refused("p1", PIN) == 401
    with pytest.raises(Problem):
        await house.sign_in.sign_in("ann", PASSWORD, "a", panel=True)
    house.now += 30 * rules.DAY
    assert await house.identity.by_cookie(cookie), "a panel stays signed in"


async def test_a_panel_from_before_that_may_too_much_is_refused(house: House) -> None:
    await house.accounts.add_panel("p1", Role.OPERATOR, PIN, "/", **BY)
    cookie = (await house.sign_in.sign_in("p1", PIN, "a", panel=True)).session
    await house.database.write(lambda c: c.execute("UPDATE users SET role = 'admin' WHERE name = 'p1'"))
    assert await house.identity.by_cookie(cookie) is None
    with pytest.raises(Problem) as caught:
        await house.sign_in.sign_in("p1", PIN, "a", panel=True)
    assert caught.value.status == 403
    assert "a panel is an operator at most" in caught.value.detail


async def test_a_worker_has_no_session_to_end(house: House) -> None:
    await house.add()
    cookie = await house.enter()
    with pytest.raises(Problem, match="role viewer"):
        await house.sign_in.sign_out(cookie, Person("ann", Role.WORKER, "token"))
    assert await house.identity.by_cookie(cookie)


async def test_shorter_lifetimes_hold_for_sessions_that_are_open(house: House) -> None:
    await house.add()
    cookie = await house.enter()
    house.sign_in.sessions = Sessions(idle_hours=0.5)
    house.now += 1799
    assert await house.identity.by_cookie(cookie, is_use=False)
    house.now += 1
    assert await house.identity.by_cookie(cookie) is None


async def test_tokens(house: House) -> None:
    for bearer in ("", "x", "ü", "x" * 10_000):
        assert await house.identity.by_token(bearer) is None
    token = await house.accounts.create_token("plc", Role.ENGINEER, **BY)
    person = await house.identity.by_token(token)
    assert person is not None
    assert (person.name, person.role, person.via) == ("plc", Role.ENGINEER, "token")
    assert (await house.accounts.tokens())[0].used_at == house.now
    await house.rights.refresh()
    await house.accounts.revoke_token("plc", **BY)
    assert await house.identity.by_token(token), "a token is known without the store"
    await house.rights.refresh()
    assert await house.identity.by_token(token) is None


async def test_a_workers_token_names_its_bus_also_those_of_the_servers_own(house: House) -> None:
    for bus, own in OWN.items():
        person = await house.identity.by_token(own)
        assert person is not None
        assert (person.role, person.via, person.bus) == (Role.WORKER, "worker", bus)
    token = await house.accounts.create_token("w", Role.WORKER, bus="dry-end", **BY)
    person = await house.identity.by_token(token)
    assert person is not None
    assert (person.role, person.via, person.bus) == (Role.WORKER, "token", "dry-end")


async def test_a_token_expires_and_its_holder_gets_the_reason(house: House) -> None:
    token = await house.accounts.create_token("plc", Role.VIEWER, expires_days=30, **BY)
    house.now += 30 * rules.DAY - 1
    assert await house.identity.by_token(token)
    house.now += 1
    with pytest.raises(Problem) as caught:
        await house.identity.by_token(token)
    assert (caught.value.status, caught.value.code) == (401, "unauthorized")
    assert caught.value.detail == "the token plc expired on 1970-02-11; an admin can create a new one"
    assert 'error="invalid_token"' in caught.value.headers["WWW-Authenticate"]


@pytest.fixture
def gone(house: House) -> list[str]:
    """Return the users reported as signed in nowhere."""
    notified: list[str] = []

    async def notify(name: str) -> None:
        notified.append(name)

    house.rights.on_withdrawn(notify)
    return notified


async def test_the_last_signing_out_is_reported_and_no_other(house: House, gone: list[str]) -> None:
    await house.add()
    first, second = await house.enter(), await house.enter()
    for cookie, notified in ((first, []), (second, ["ann"])):
        person = await house.identity.by_cookie(cookie)
        assert person is not None
        await house.sign_in.sign_out(cookie, person)
        assert gone == notified
        assert await house.identity.by_cookie(cookie) is None


async def test_a_session_that_is_over_is_reported_once(house: House, gone: list[str]) -> None:
    await house.add()
    cookie = await house.enter()
    house.now += LIFETIME.idle_s + 1
    assert [await house.identity.by_cookie(cookie) for _ in range(2)] == [None, None]
    assert gone == ["ann"]


async def test_a_session_that_no_one_uses_is_over_without_a_request(house: House, gone: list[str]) -> None:
    await house.add()
    await house.enter()
    house.now += LIFETIME.idle_s - 1
    await house.rights.refresh()
    assert gone == []
    house.now += 1
    for _ in range(2):
        await house.rights.refresh()
    assert gone == ["ann"]


async def test_an_own_new_password_ends_other_sessions_and_withdraws_nothing(
    house: House, gone: list[str]
) -> None:
    """Whichever look at the store comes first: the session of the browser goes on, and control of a line."""
    await house.add()
    cookie, other = await house.enter(), await house.enter()
    person = await house.identity.by_cookie(cookie)
    assert person is not None
    new = "another good one"
    await house.accounts.change_own_password(new, by=person, keep=rules.secret_hash(cookie))
    assert await house.identity.by_cookie(cookie)
    assert await house.identity.by_cookie(other) is None
    await house.rights.refresh()
    assert gone == []
    await house.accounts.set_password("ann", f"x{new}", **BY)
    await house.rights.refresh()
    assert gone == ["ann"]
