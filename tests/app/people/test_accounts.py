"""Users and tokens, and who is told apart of those that have one name."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import httpx
import pytest

from app.core.database import Database
from app.core.web.access import Person, Role
from app.errors import Problem
from app.people.audit.acts import Act
from app.people.audit.log import EventLog, Filter
from app.people.auth import rules, store
from app.people.auth.accounts import (
    ACTS,
    ADD_PANEL,
    ADD_USER,
    CHANGE_OWN_PASSWORD,
    CREATE_TOKEN,
    CREATE_WORKER_TOKEN,
    DISABLE_USER,
    ENABLE_USER,
    LOG_OUT,
    REMOVE_USER,
    REVOKE_TOKEN,
    SET_PASSWORD,
    SET_ROLE,
    Accounts,
)
from app.people.auth.store import CompanyAccount, User
from bus.errors import CallerError
from bus.messages import Message
from tests.administrator import BY
from tests.app.complete_app import House, complete_app

PASSWORD = "correct horse"


PIN = "471193"


ANN = Person("ann", Role.OPERATOR, "session")


@pytest.fixture
async def accounts(tmp_path: Path) -> AsyncIterator[Accounts]:
    database = Database(tmp_path / "lineside.db")
    yield Accounts(database, EventLog(database))
    database.close()


async def test_a_name_is_given_once(accounts: Accounts) -> None:
    await accounts.add_user("ann", Role.VIEWER, PASSWORD, **BY)
    with pytest.raises(CallerError, match="a user ann exists already"):
        await accounts.add_user("ann", Role.ADMIN, PASSWORD, **BY)
    assert [(user.name, user.role) for user in await accounts.users()] == [("ann", Role.VIEWER)]
    await accounts.create_token("plc", Role.VIEWER, **BY)
    with pytest.raises(CallerError, match="a token plc exists already"):
        await accounts.create_token("plc", Role.VIEWER, **BY)


async def test_a_name_that_looks_like_another_is_not_given(accounts: Accounts) -> None:
    await accounts.add_user("ann", Role.VIEWER, PASSWORD, **BY)
    await accounts.create_token("plc", Role.VIEWER, **BY)
    with pytest.raises(CallerError, match="looks like 'ann'"):
        await accounts.add_user("Ann", Role.ADMIN, PASSWORD, **BY)
    with pytest.raises(CallerError, match="looks like 'ann'"):
        await accounts.add_panel("ANN", Role.VIEWER, "482913", "/", **BY)
    with pytest.raises(CallerError, match="looks like 'plc'"):
        await accounts.create_token("pIc", Role.VIEWER, **BY)
    await accounts.create_token("Ann", Role.VIEWER, **BY)


async def test_no_account_and_no_password(accounts: Accounts) -> None:
    with pytest.raises(CallerError, match="no user eve"):
        await accounts.set_role("eve", Role.ADMIN, **BY)
    with pytest.raises(CallerError, match="no user eve"):
        await accounts.set_password("eve", PASSWORD, **BY)
    with pytest.raises(CallerError, match="no user eve"):
        await accounts.remove_user("eve", **BY)
    with pytest.raises(CallerError, match="no token plc"):
        await accounts.revoke_token("plc", **BY)


@pytest.mark.parametrize("ending", ["role", "disable", "remove"])
async def test_an_admin_remains(accounts: Accounts, ending: str) -> None:
    changes = {
        "role": lambda: accounts.set_role("ann", Role.ENGINEER, **BY),
        "disable": lambda: accounts.set_disabled("ann", True, **BY),
        "remove": lambda: accounts.remove_user("ann", **BY),
    }
    await accounts.add_user("ann", Role.ADMIN, PASSWORD, **BY)
    await accounts.add_user("bob", Role.VIEWER, PASSWORD, **BY)
    with pytest.raises(CallerError, match="the last admin who logs in with a password is ann"):
        await changes[ending]()
    assert (await accounts.users())[0].role is Role.ADMIN
    await accounts.set_role("bob", Role.ADMIN, **BY)
    await changes[ending]()


async def test_what_a_name_may_do(accounts: Accounts) -> None:
    await accounts.add_user("ann", Role.OPERATOR, PASSWORD, **BY)
    await accounts.create_token("recipes", Role.ENGINEER, **BY)
    assert [await accounts.find(name) for name in ("ann", "recipes", "nobody")] == [
        ("ann", Role.OPERATOR),
        ("recipes (token)", Role.ENGINEER),
        None,
    ]
    await accounts.set_disabled("ann", True, **BY)
    assert await accounts.find("ann") is None


async def test_a_token_that_has_expired_may_do_nothing(accounts: Accounts) -> None:
    await accounts.create_token("recipes", Role.ENGINEER, expires_days=1, **BY)
    accounts._clock = lambda: time.time() + 2 * rules.DAY
    assert await accounts.find("recipes") is None


async def test_a_user_and_a_token_of_one_name_are_two(accounts: Accounts) -> None:
    await accounts.add_user("ann", Role.OPERATOR, PASSWORD, **BY)
    await accounts.create_token("ann", Role.ENGINEER, **BY)
    assert await accounts.find("ann") == ("ann", Role.OPERATOR)
    assert await accounts.find("ann (token)") == ("ann (token)", Role.ENGINEER)


async def test_every_change_is_an_event_with_its_author(accounts: Accounts) -> None:
    await accounts.add_user("ann", Role.VIEWER, PASSWORD, **BY)
    await accounts.set_role("ann", Role.OPERATOR, **BY)
    await accounts.set_disabled("ann", True, **BY)
    await accounts.remove_user("ann", **BY)
    found, _ = await accounts._events.page(Filter(kind="user"), 10)
    assert [event["what"] for event in reversed(found)] == [
        "user ann added as viewer",
        "user ann is now operator",
        "user ann disabled",
        "user ann removed",
    ]
    assert {event["who"] for event in found} == {"test"}


CHANGES: dict[str, Callable[[Accounts, Person], Awaitable[object]]] = {
    act.name: change
    for act, change in (
        (ADD_USER, lambda accounts, by: accounts.add_user("eve", Role.ADMIN, PASSWORD, by=by)),
        (ADD_PANEL, lambda accounts, by: accounts.add_panel("p2", Role.VIEWER, PIN, "/", by=by)),
        (SET_ROLE, lambda accounts, by: accounts.set_role("ann", Role.ADMIN, by=by)),
        (DISABLE_USER, lambda accounts, by: accounts.set_disabled("ann", True, by=by)),
        (ENABLE_USER, lambda accounts, by: accounts.set_disabled("off", False, by=by)),
        (SET_PASSWORD, lambda accounts, by: accounts.set_password("ann", PASSWORD, by=by)),
        (REMOVE_USER, lambda accounts, by: accounts.remove_user("ann", by=by)),
        (CREATE_TOKEN, lambda accounts, by: accounts.create_token("t", Role.ADMIN, by=by)),
        (CREATE_WORKER_TOKEN, lambda accounts, by: accounts.create_token("t", Role.WORKER, bus="b", by=by)),
        (REVOKE_TOKEN, lambda accounts, by: accounts.revoke_token("plc", by=by)),
        (CHANGE_OWN_PASSWORD, lambda accounts, by: accounts.change_own_password(PASSWORD, by=by, keep=b"")),
    )
}
"""By act, a change that a person requests."""


async def stored(accounts: Accounts) -> tuple[object, ...]:
    """All that a change can change."""
    hashes = await accounts._database.read(store.secret_hashes)
    events, _ = await accounts._events.page(Filter(), 50)
    return (await accounts.users(), await accounts.tokens(), hashes, len(events))


@pytest.mark.parametrize("act", [act for act in ACTS if act is not LOG_OUT], ids=lambda act: act.name)
async def test_a_change_is_refused_to_a_person_without_its_role(accounts: Accounts, act: Act) -> None:
    accounts.buses = ("b",)
    await accounts.add_user("ann", Role.ENGINEER, PASSWORD, **BY)
    await accounts.add_user("off", Role.VIEWER, PASSWORD, **BY)
    await accounts.set_disabled("off", True, **BY)
    await accounts.create_token("plc", Role.VIEWER, **BY)
    before = await stored(accounts)
    for role in Role:
        if not role.includes(act.role):
            with pytest.raises(Problem, match=f"role {act.role}") as refused:
                await CHANGES[act.name](accounts, Person("ann", role, "session"))
            assert (refused.value.status, refused.value.code) == (403, "forbidden")
    assert await stored(accounts) == before


@pytest.mark.parametrize(
    "person",
    [Person("ann", Role.ADMIN, "token"), Person("ann", Role.OPERATOR, "session", panel=True)],
    ids=["program", "panel"],
)
async def test_a_program_or_a_panel_changes_no_own_password(accounts: Accounts, person: Person) -> None:
    await accounts.add_user("ann", Role.OPERATOR, PASSWORD, **BY)
    before = await stored(accounts)
    with pytest.raises(Problem, match=r"only a logged-in user|only an admin"):
        await CHANGES[CHANGE_OWN_PASSWORD.name](accounts, person)
    assert await stored(accounts) == before


async def test_a_user_of_the_machine_without_a_name_is_recorded_as_the_command_line(
    accounts: Accounts,
) -> None:
    line = Message("command_line")
    await accounts.create_token("plc", Role.VIEWER, by=Person("", Role.ADMIN, "console", address=line))
    events, _ = await accounts._events.page(Filter(kind="token"), 1)
    assert (events[0]["who"], (await accounts.tokens())[0].created_by) == (str(line), str(line))


async def test_subscribers_get_each_change(accounts: Accounts) -> None:
    received = 0

    async def receive() -> None:
        nonlocal received
        received += 1

    accounts.on_changed(receive)
    await accounts.add_user("ann", Role.VIEWER, PASSWORD, **BY)
    await accounts.set_role("ann", Role.OPERATOR, **BY)
    await accounts.change_own_password("another good one", keep=b"session", by=ANN)
    await accounts.create_token("plc", Role.VIEWER, **BY)
    await accounts.revoke_token("plc", **BY)
    assert received == 5


async def test_every_way_to_a_password_or_pin_has_the_same_rules(accounts: Accounts) -> None:
    with pytest.raises(CallerError, match="12 to 256 characters"):
        await accounts.add_user("ann", Role.VIEWER, "x", **BY)
    with pytest.raises(CallerError, match="contains the user name"):
        await accounts.add_user("annabel", Role.VIEWER, "annabel-is-the-best", **BY)
    with pytest.raises(CallerError, match="6 to 12 digits"):
        await accounts.add_panel("p1", Role.VIEWER, "0000", "/", **BY)
    await accounts.add_user("ann", Role.VIEWER, PASSWORD, **BY)
    await accounts.add_panel("p1", Role.VIEWER, "471193", "/", **BY)
    for name, secret in (("ann", "short"), ("ann", "passwordpassword"), ("p1", "123456"), ("p1", PASSWORD)):
        with pytest.raises(CallerError):
            await accounts.set_password(name, secret, **BY)


async def test_a_panel_is_operator_at_most(accounts: Accounts) -> None:
    role = Role.ENGINEER
    with pytest.raises(CallerError, match="a panel is an operator at most"):
        await accounts.add_panel("p1", role, "471193", "/", **BY)
    await accounts.add_panel("p1", Role.OPERATOR, "471193", "/", **BY)
    with pytest.raises(CallerError, match="a panel is an operator at most"):
        await accounts.set_role("p1", role, **BY)
    assert (await accounts.users())[0].role is Role.OPERATOR


ACCOUNT = CompanyAccount("https://login.plant.example", "248289761001")


async def followed(accounts: Accounts, name: str, role: Role, account: CompanyAccount = ACCOUNT) -> User:
    return await accounts.follow_provider(account, name, role, address="192.0.2.7")


async def test_the_user_of_a_company_account_follows_it(accounts: Accounts) -> None:
    added = await followed(accounts, "anna", Role.OPERATOR)
    assert (added.name, added.role, added.company_account) == ("anna", Role.OPERATOR, ACCOUNT)
    raised = await followed(accounts, "renamed", Role.ADMIN)
    assert (raised.name, raised.role) == ("anna", Role.ADMIN)
    assert await accounts.users() == [raised]
    assert await followed(accounts, "anna", Role.ADMIN) == raised
    other = ACCOUNT._replace(issuer="https://other.example")
    with pytest.raises(CallerError, match="a user anna exists already"):
        await followed(accounts, "anna", Role.VIEWER, other)
    with pytest.raises(CallerError, match="looks like 'anna'"):
        await followed(accounts, "Anna", Role.VIEWER, ACCOUNT._replace(subject="1"))
    with pytest.raises(CallerError, match="is not allowed"):
        await followed(accounts, "", Role.VIEWER, ACCOUNT._replace(subject="1"))


async def test_two_logins_of_a_company_account_make_one_user(accounts: Accounts) -> None:
    users = await asyncio.gather(*(followed(accounts, "anna", Role.VIEWER) for _ in range(4)))
    assert len(set(users)) == 1
    assert len(await accounts.users()) == 1


async def test_a_disabled_company_account_is_left_as_is(accounts: Accounts) -> None:
    await followed(accounts, "anna", Role.OPERATOR)
    await accounts.set_disabled("anna", True, **BY)
    found = await followed(accounts, "anna", Role.ADMIN)
    assert (found.disabled, found.role) == (True, Role.OPERATOR)


async def test_role_and_password_of_a_company_account_are_not_here(accounts: Accounts) -> None:
    await followed(accounts, "anna", Role.OPERATOR)
    with pytest.raises(CallerError, match="follows the groups of the company account"):
        await accounts.set_role("anna", Role.ADMIN, **BY)
    with pytest.raises(CallerError, match="no password here"):
        await accounts.set_password("anna", PASSWORD, **BY)
    anna = Person("anna", Role.OPERATOR, "session", has_company_account=True)
    with pytest.raises(Problem, match="no password here"):
        await accounts.change_own_password(PASSWORD, by=anna, keep=b"")


async def test_an_admin_with_a_password_remains(accounts: Accounts) -> None:
    await followed(accounts, "anna", Role.ADMIN)
    await accounts.add_first_admin("boss", PASSWORD, address="192.0.2.7")
    with pytest.raises(CallerError, match="the last admin who logs in with a password is boss"):
        await accounts.remove_user("boss", **BY)
    assert (await followed(accounts, "anna", Role.VIEWER)).role is Role.VIEWER
    await accounts.remove_user("anna", **BY)
    assert (await followed(accounts, "anna", Role.VIEWER)).name == "anna"
    with pytest.raises(Problem, match="there is a user already"):
        await accounts.add_first_admin("another", PASSWORD, address="192.0.2.7")


async def test_no_hash_is_compared_for_a_company_account(accounts: Accounts) -> None:
    """Else the time of a login would show who has one."""
    await accounts.add_user("boss", Role.ADMIN, PASSWORD, **BY)
    await followed(accounts, "anna", Role.OPERATOR)
    [stored] = await accounts._database.read(store.secret_hashes)
    assert stored.startswith("$argon2id$")


BUS = "/api/v1/buses/dry-end"


SPEED = f"{BUS}/units/1/speed"


NAME = "key-operator"


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path, control=True) as house:
        yield house


@pytest.fixture
async def user(house: House) -> httpx.AsyncClient:
    return await house.signed_in(Role.OPERATOR, NAME)


@pytest.fixture
async def token(house: House) -> httpx.AsyncClient:
    return await house.program(Role.OPERATOR)


async def test_control_of_one_is_not_that_of_the_other(
    house: House, user: httpx.AsyncClient, token: httpx.AsyncClient
) -> None:
    lease = (await user.post(f"{BUS}/control")).json()
    assert (lease["holder"], lease["is_token"]) == (NAME, False)
    response = await token.post(SPEED, json={"raw": 5})
    assert (response.status_code, response.json()["code"]) == (409, "controlled")
    assert (await token.post(f"{BUS}/control")).status_code == 409
    assert (await token.request("DELETE", f"{BUS}/control")).status_code == 409
    assert (await user.post(SPEED, json={"raw": 5})).json()["code"] == "bus_closed", "it came past control"
    handed = (await user.post(f"{BUS}/control/hand-over", json={"to": f"{NAME} (token)"})).json()
    assert (handed["holder"], handed["is_token"]) == (NAME, True)
    assert (await user.post(SPEED, json={"raw": 5})).json()["code"] == "controlled"
    page = await user.get("/control?bus=dry-end")
    assert f"Control: {NAME} (token)" in page.text
    assert [(event["old"], event["new"]) for event in await house.events("control")] == [
        (NAME, f"{NAME} (token)"),
        (None, NAME),
    ]


async def test_what_the_one_holds_stays_when_the_other_goes(house: House, user: httpx.AsyncClient) -> None:
    await house.token(Role.OPERATOR)
    await user.post(f"{BUS}/control")
    await house.services[Accounts].revoke_token(NAME, **BY)
    assert (await user.get(f"{BUS}/control")).json()["holder"] == NAME


async def test_a_key_of_one_is_not_that_of_the_other(
    user: httpx.AsyncClient, token: httpx.AsyncClient
) -> None:
    key = {"Idempotency-Key": "press-1"}
    await user.post(f"{BUS}/control")
    assert (await user.post(SPEED, json={"raw": 5}, headers=key)).json()["code"] == "bus_closed"
    response = await token.post(SPEED, json={"raw": 5}, headers=key)
    assert response.json()["code"] == "controlled", "a separate command, and refused as such"


async def test_the_events_name_which_of_them_it_was(
    house: House, user: httpx.AsyncClient, token: httpx.AsyncClient
) -> None:
    for client in (user, token):
        await client.post(f"{BUS}/control")
        await client.post(SPEED, json={"raw": 5})
        await client.request("DELETE", f"{BUS}/control")
    for kind, origins in (
        ("command", ["api, token", "api"]),
        ("control", [*["token"] * 2, *["session"] * 2]),
    ):
        events = await house.events(kind)
        assert [event["origin"] for event in events] == origins
        assert {event["who"] for event in events} == {NAME}
