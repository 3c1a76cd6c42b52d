"""Login, account and users as pages: input and response."""

from __future__ import annotations

import re
import unicodedata
from typing import Literal

import httpx
import pytest
from argon2 import PasswordHasher

from app.core.database import Database
from app.core.web.access import Role
from app.people.auth import store
from app.people.auth.accounts import Accounts
from app.people.auth.pages import DEVICE_COOKIE
from tests.administrator import BY
from tests.app.complete_app import PASSWORD, House
from tests.for_each import for_each

HTML = {"accept": "text/html"}
PIN = "471193"
FORMS: tuple[Literal["NFC", "NFD"], ...] = ("NFC", "NFD")


@pytest.fixture
async def admin(house: House) -> httpx.AsyncClient:
    return await house.signed_in(Role.ADMIN, "ada")


async def names(house: House) -> dict[str, str]:
    return {user.name: user.role.value for user in await house.services[Accounts].users()}


async def can_sign_in(house: House, name: str, password: str) -> bool:
    response = await house.client().post("/login", data={"name": name, "password": password})
    return response.status_code == 303


async def test_a_site_without_users_shows_how_to_begin(house: House) -> None:
    login = (await house.client().get("/login")).text
    assert "lineside user add NAME" in login
    assert 'href="/setup"' in login
    await house.add("ann", Role.VIEWER)
    assert "lineside user add NAME" not in (await house.client().get("/login")).text


async def test_login_goes_where_one_wanted_to_go(house: House) -> None:
    await house.add("ann", Role.VIEWER)
    client = house.client()
    wanted = await client.get("/events?unit=2", headers=HTML)
    form = await client.get(wanted.headers["location"])
    assert 'name="next" value="/events?unit=2"' in form.text
    data = {"name": " ann ", "password": PASSWORD, "next": "/events?unit=2"}
    response = await client.post("/login", data=data)
    assert (response.status_code, response.headers["location"]) == (303, "/events?unit=2")
    assert (await client.get("/login?next=/account")).headers["location"] == "/account"


@for_each("target", ["https://evil.example", "//evil.example", "/\\evil.example"])
async def test_login_never_leads_elsewhere(house: House, target: str) -> None:
    await house.add("ann", Role.VIEWER)
    data = {"name": "ann", "password": PASSWORD, "next": target}
    assert (await house.client().post("/login", data=data)).headers["location"] == "/"
    client = await house.signed_in(Role.VIEWER)
    assert (await client.get("/login", params={"next": target})).headers["location"] == "/"


async def test_a_wrong_password_keeps_the_name_but_not_the_password(house: House) -> None:
    await house.add("ann", Role.VIEWER)
    response = await house.client().post("/login", data={"name": "ann", "password": "my-wrong-one"})
    assert response.status_code == 401
    assert 'value="ann"' in response.text
    assert "my-wrong-one" not in response.text
    assert "wrong name or password" in response.text


async def test_a_panel_begins_at_its_home_page(house: House) -> None:
    await house.services[Accounts].add_panel("p1", Role.VIEWER, PIN, "/units/dry-end/1", **BY)
    client = house.client()
    assert 'name="pin"' in (await client.get("/login?panel=true")).text
    response = await client.post("/login/panel", data={"name": "p1", "pin": PIN})
    assert response.headers["location"] == "/units/dry-end/1"
    assert (await client.post("/account/password", data={"password": "x"})).status_code == 403


@for_each(
    ("present", "password", "repeated", "expected"),
    [
        (PASSWORD, "short", "short", "12 to 256 characters"),
        (PASSWORD, "passwordpassword", "passwordpassword", "easy to guess"),
        (PASSWORD, "a good new one", "but different", "the two new passwords differ"),
        ("not mine", "a good new one", "a good new one", "wrong current password"),
    ],
)
async def test_ones_own_password_is_not_changed_for_nothing(
    house: House, present: str, password: str, repeated: str, expected: str
) -> None:
    client = await house.signed_in(Role.VIEWER, "ann")
    form = {"present": present, "password": password, "again": repeated}
    response = await client.post("/account/password", data=form)
    assert response.status_code == 422
    assert expected in response.text
    assert await can_sign_in(house, "ann", PASSWORD)


async def test_ones_own_password_is_changed_and_every_other_device_is_out(house: House) -> None:
    client, other = await house.signed_in(Role.VIEWER, "ann"), house.client()
    await other.post("/login", data={"name": "ann", "password": PASSWORD})
    form = {"present": PASSWORD, "password": "a new long one", "again": "a new long one"}
    assert (await client.post("/account/password", data=form)).status_code == 303
    assert (await client.get("/api/v1/me")).status_code == 200
    assert (await other.get("/api/v1/me")).status_code == 401


async def test_a_weak_password_is_reported_to_the_admin(house: House, admin: httpx.AsyncClient) -> None:
    assert "still in use" not in (await admin.get("/users")).text
    await house.services[Database].write(lambda c: c.execute("UPDATE users SET weak_secret = 1"))
    assert "must change theirs: ada." in (await admin.get("/users")).text


async def test_a_browser_that_signed_in_is_known_again(house: House) -> None:
    client = await house.signed_in(Role.VIEWER, "ann")
    device = client.cookies[DEVICE_COOKIE]
    await client.post("/logout")
    response = await client.post("/login", data={"name": "ann", "password": PASSWORD})
    assert device in response.headers["set-cookie"]
    client.cookies.set(DEVICE_COOKIE, "x" * 4000)
    response = await client.post("/login", data={"name": "ann", "password": PASSWORD})
    assert "x" * 44 not in response.headers["set-cookie"]


@pytest.mark.parametrize("form", ["NFC", "NFD"])
async def test_names_and_passwords_are_the_same_however_their_accents_are_typed(
    house: House, admin: httpx.AsyncClient, form: Literal["NFC", "NFD"]
) -> None:
    texts = ("jürgen", "schöne grüne äpfel")
    name, password = (unicodedata.normalize(form, text) for text in texts)
    added = {"name": name, "role": "viewer", "password": password}
    assert (await admin.post("/users", data=added)).status_code == 303
    assert (await names(house))["jürgen"] == "viewer"
    for each in FORMS:
        name, password = (unicodedata.normalize(each, text) for text in texts)
        assert await can_sign_in(house, name, password)
    assert not await can_sign_in(house, "jürgen", "schone grune apfel")
    assert not await can_sign_in(house, "jurgen", "schöne grüne äpfel")


@for_each("form", ["NFC", "NFD"])
async def test_a_password_hashed_as_it_was_typed_stays_valid(
    house: House, form: Literal["NFC", "NFD"]
) -> None:
    await house.add("ann", Role.VIEWER)
    password = "schöne grüne äpfel"
    hashed = PasswordHasher(time_cost=1, memory_cost=64).hash(unicodedata.normalize(form, password))
    await house.services[Database].write(lambda c: store.set_secret(c, "ann", hashed))
    for each in FORMS:
        assert await can_sign_in(house, "ann", unicodedata.normalize(each, password))


async def test_separate_accents_make_no_password_longer(admin: httpx.AsyncClient) -> None:
    typed = {"name": "ann", "role": "viewer", "password": unicodedata.normalize("NFD", "öxäqüvçzñ")}
    assert (await admin.post("/users", data=typed)).status_code == 422


async def test_a_worker_and_an_expiry_are_shown_with_their_token(
    house: House, admin: httpx.AsyncClient
) -> None:
    form = {"token": "cabinet", "token_role": "worker", "token_bus": "dry-end", "expires": "30"}
    assert (await admin.post("/users/tokens", data=form)).status_code == 200
    (token,) = await house.services[Accounts].tokens()
    assert (token.role, token.bus) == (Role.WORKER, "dry-end")
    assert token.expires_at is not None
    assert token.expires_at - token.created_at == 30 * 86_400
    assert "worker, dry-end" in (await admin.get("/users")).text


async def test_a_token_has_no_account(house: House) -> None:
    program = await house.program(Role.ADMIN)
    assert (await program.post("/account/password", data={"password": "x"})).status_code == 403
    assert (await program.get("/account")).status_code == 200


async def test_an_admin_adds_changes_and_removes_people(house: House, admin: httpx.AsyncClient) -> None:
    form = {"name": "bob", "role": "operator", "password": "a good new one"}
    after = (await admin.post("/users", data=form)).headers["location"]
    page = (await admin.get(after)).text
    assert 'data-user="bob"' in page
    assert "was added." in page
    after = (await admin.post("/users/bob/role", data={"role": "engineer"})).headers["location"]
    assert "has a new role." in (await admin.get(after)).text
    assert (await names(house))["bob"] == "engineer"
    await admin.post("/users/bob/password", data={"password": "another long one"})
    assert await can_sign_in(house, "bob", "another long one")
    await admin.post("/users/bob/disable")
    assert not await can_sign_in(house, "bob", "another long one")
    await admin.post("/users/bob/enable")
    assert await can_sign_in(house, "bob", "another long one")
    await admin.post("/users/bob/remove")
    assert list(await names(house)) == ["ada"]


@for_each(
    ("path", "form", "expected"),
    [
        ("/users", {"name": "a b", "password": "a good new one"}, "without spaces"),
        ("/users", {"name": "bob", "role": "king", "password": "a good new one"}, "there is no role"),
        ("/users/panels", {"panel": "p1", "pin": "12"}, "6 to 12 digits"),
        ("/users/panels", {"panel": "p1", "pin": PIN, "panel_role": "admin"}, "an operator at most"),
        ("/users/panels", {"panel": "p1", "pin": PIN, "home": "//evil"}, "a path on this server"),
        ("/users", {"name": "bob", "password": "at-mill-7-we-go"}, "contains the name of the site"),
        ("/users/ada/disable", {}, "the last admin who logs in with a password is ada"),
        ("/users/eve/role", {"role": "viewer"}, "there is no user eve"),
        ("/users/ada/password", {"password": "short"}, "12 to 256 characters"),
        ("/users/tokens", {"token": "t", "token_role": "worker"}, "is for one bus; give one of dry-end"),
        ("/users/tokens", {"token": "t", "expires": "soon"}, "an integer, or empty"),
        ("/users/tokens/none/revoke", {}, "there is no token none"),
    ],
)
async def test_a_refusal_states_its_reason(
    house: House, admin: httpx.AsyncClient, path: str, form: dict[str, str], expected: str
) -> None:
    response = await admin.post(path, data=form, headers=HTML)
    assert response.status_code == 422
    assert expected in response.text
    assert await names(house) == {"ada": "admin"}


async def test_a_panel_is_given_a_new_pin(house: House, admin: httpx.AsyncClient) -> None:
    await admin.post("/users/panels", data={"panel": "p1", "pin": PIN, "home": "/"})
    assert (await admin.post("/users/p1/password", data={"password": "abcdefgh"})).status_code == 422
    assert (await admin.post("/users/p1/password", data={"password": "908172"})).status_code == 303
    assert (
        await house.client().post("/login/panel", data={"name": "p1", "pin": "908172"})
    ).status_code == 303


async def test_a_token_is_shown_once(house: House, admin: httpx.AsyncClient) -> None:
    response = await admin.post("/users/tokens", data={"token": "plc", "token_role": "operator"})
    found = re.search(r"data-token>([\w-]+)<", response.text)
    assert found
    program = house.client(authorization=f"Bearer {found[1]}")
    assert (await program.get("/api/v1/me")).json()["role"] == "operator"
    assert found[1] not in (await admin.get("/users")).text
    await admin.post("/users/tokens/plc/revoke")
    assert (await program.get("/api/v1/me")).status_code == 401


async def test_an_irreversible_action_is_confirmed_and_ends_in_the_dialog(
    house: House, admin: httpx.AsyncClient
) -> None:
    await admin.post("/users/tokens", data={"token": "plc"})
    page = await admin.get("/users/tokens/plc/revoke", headers=HTML)
    assert "are refused from now on" in page.text
    assert 'hx-post="/users/tokens/plc/revoke"' in page.text
    fragment = HTML | {"hx-request": "true"}
    refused = await admin.post("/users/tokens/none/revoke", headers=fragment)
    assert (refused.status_code, "there is no token none" in refused.text) == (422, True)
    done = await admin.post("/users/tokens/plc/revoke", headers=fragment)
    assert done.status_code == 200
    assert "The token was revoked." in (await admin.get(done.headers["hx-redirect"])).text
    again = await admin.get("/users")
    assert "The token was revoked." not in again.text, "it is said once"
    assert [token.name for token in await house.services[Accounts].tokens()] == []


@pytest.mark.parametrize(
    ("link", "lie"),
    [
        ("/users?done=revoked&name=plc", "The token was revoked."),
        ("/users?done=removed", "The user was removed."),
        ("/account?done=password", "The password was changed."),
    ],
)
async def test_a_link_cannot_say_that_something_was_done(
    admin: httpx.AsyncClient, link: str, lie: str
) -> None:
    assert lie not in (await admin.get(link)).text
    admin.cookies.set("lineside_result", "page=/users&done=revoked&done=%ff&name=a&x=y")
    assert (await admin.get("/users")).status_code == 200
