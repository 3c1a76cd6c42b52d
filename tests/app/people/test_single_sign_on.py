"""Signing in with a company account: the way there and back, its user, what ends it, and its settings."""

from __future__ import annotations

import asyncio
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest
from starlette.types import Message

from app.cli.check import oidc
from app.core.lifespan import StartError
from app.core.web.access import SESSION, Role
from app.people.auth import single_sign_on
from app.people.auth.accounts import Accounts
from app.people.auth.identify import NO_LONGER_SIGNED_IN
from app.people.auth.pages import ATTEMPT_COOKIE
from app.people.auth.provider import Provider
from app.people.auth.single_sign_on import SingleSignOn
from app.settings import ConfigurationError, Settings, load
from tests.administrator import BY
from tests.app.complete_app import HOST, PASSWORD, House, complete_app
from tests.app.notification_servers import certificate, server_context
from tests.app.played_provider import (
    CALLBACK,
    NEW_KEY,
    SECRET,
    PlayedProvider,
    house_with_provider,
    known,
    logged_in,
    played_provider,
    provider_alone,
    reason_of,
    sent,
    signed,
)
from tests.for_each import for_each

provider = pytest.fixture(provider_alone)


house = pytest.fixture(house_with_provider)


async def me(client: httpx.AsyncClient) -> dict[str, str]:
    return (await client.get("/api/v1/me")).json()


async def users(house: House) -> dict[str, Role]:
    return {user.name: user.role for user in await house.services[Accounts].users()}


async def test_a_person_logs_in_and_gets_the_page_that_was_wanted(
    house: House, provider: PlayedProvider
) -> None:
    client = house.client()
    assert "Log in with the company account" in (await client.get("/login?next=/events")).text
    back = provider.login(await sent(client, "/events?unit=2"))
    response = await client.get(CALLBACK, params=back)
    assert (response.status_code, response.headers["location"]) == (303, "/events?unit=2")
    assert await me(client) == {"name": "anna", "role": "operator", "via": "session"}
    assert ATTEMPT_COOKIE not in client.cookies
    [login] = await house.events("login")
    assert (login["who"], login["what"]) == ("anna", "logged in with a company account")
    [added] = await house.events("user")
    assert (added["who"], added["what"]) == ("anna", "user anna of a company account added as operator")


async def test_the_highest_role_of_the_groups_counts(house: House, provider: PlayedProvider) -> None:
    provider.claims = {"groups": ["other", "line-admins", 7, "line-viewers"]}
    client = house.client()
    await logged_in(client, provider)
    assert (await me(client))["role"] == "admin"


async def test_a_person_in_no_group_is_refused_and_counted(house: House, provider: PlayedProvider) -> None:
    client = house.client()
    for groups in (None, [], ["other"], "other", {"line-admins": True}, [["line-admins"]]):
        provider.claims = {"groups": groups}
        response = await logged_in(client, provider)
        assert reason_of(response) == "groups"
    assert "in no group that may use Lineside" in (await client.get(response.headers["location"])).text
    assert SESSION not in client.cookies
    assert await users(house) == {}
    refused = (await house.events("login_refused"))[-1]
    assert (refused["who"], refused["what"]) == ("anna", "login with a company account refused")


async def test_a_name_that_a_user_has_is_never_taken_over(house: House, provider: PlayedProvider) -> None:
    await house.add("anna", Role.ADMIN)
    client = house.client()
    response = await logged_in(client, provider)
    assert reason_of(response) == "name_taken"
    assert "another user with the name" in (await client.get(response.headers["location"])).text
    provider.claims = {"preferred_username": "Anna"}
    assert reason_of(await logged_in(house.client(), provider)) == "name_taken"
    assert await users(house) == {"anna": Role.ADMIN}


async def test_a_name_that_no_user_may_have(house: House, provider: PlayedProvider) -> None:
    for name in (None, "", "an na", "x" * 41, 7, "Анна"):
        provider.claims = {"preferred_username": name}
        assert reason_of(await logged_in(house.client(), provider)) == "name"


async def test_a_disabled_user_stays_refused(house: House, provider: PlayedProvider) -> None:
    client = house.client()
    await logged_in(client, provider)
    await house.services[Accounts].set_disabled("anna", True, **BY)
    assert (await client.get("/api/v1/me")).status_code == 401
    provider.claims = {"groups": ["line-admins"]}
    assert reason_of(await logged_in(house.client(), provider)) == "disabled"
    assert await users(house) == {"anna": Role.OPERATOR}


async def test_a_lower_role_closes_open_connections(house: House, provider: PlayedProvider) -> None:
    """Another login of the same person, with fewer groups, ends what the first one could do."""
    provider.claims = {"groups": ["line-admins"]}
    client = house.client()
    await logged_in(client, provider)
    closed: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    is_open, coming = asyncio.Event(), [{"type": "websocket.connect"}]

    async def receive() -> Message:
        return coming.pop() if coming else await asyncio.Event().wait()  # type: ignore[return-value]

    async def send(message: Message) -> None:
        if message["type"] == "websocket.close" and not closed.done():
            closed.set_result(message["code"])
        is_open.set()

    headers = [(b"host", HOST.encode()), (b"cookie", f"{SESSION}={client.cookies[SESSION]}".encode())]
    scope = {"type": "websocket", "path": "/live", "query_string": b"", "headers": headers, "scheme": "ws"}
    socket = asyncio.create_task(house.app(scope, receive, send))
    await is_open.wait()
    assert not closed.done()
    provider.claims = {"groups": ["line-viewers"]}
    await logged_in(house.client(), provider)
    async with asyncio.timeout(60):
        assert await closed == NO_LONGER_SIGNED_IN
        await socket
    assert (await me(client))["role"] == "viewer"
    changed = (await house.events("user"))[0]
    assert changed["what"] == "user anna is now viewer, by the groups of the company account"


async def test_the_cookies_are_bound_to_the_host_under_tls(house: House, provider: PlayedProvider) -> None:
    client = house.client()
    client.base_url = f"https://{HOST}"
    begun = await client.get("/login/oidc")
    [cookie] = begun.headers.get_list("set-cookie")
    assert cookie.startswith(f"__Host-{ATTEMPT_COOKIE}=")
    assert {"HttpOnly", "Max-Age=600", "Path=/", "SameSite=lax", "Secure"} <= set(cookie.split("; "))
    back = await client.get(CALLBACK, params=provider.login(begun.headers["location"]))
    assert back.headers["location"] == "/"
    assert (await me(client))["name"] == "anna"


async def test_after_a_logout_the_person_signs_in_there_again(house: House, provider: PlayedProvider) -> None:
    client = house.client()
    assert "prompt" not in parse_qs(urlsplit(await sent(client)).query)
    await logged_in(client, provider)
    await client.post("/logout")
    url = await sent(client)
    assert parse_qs(urlsplit(url).query)["prompt"] == ["login"]
    await client.get(CALLBACK, params=provider.login(url))
    client.cookies.delete(SESSION)
    assert "prompt" not in parse_qs(urlsplit(await sent(client)).query)


async def test_there_is_no_password(house: House, provider: PlayedProvider) -> None:
    await house.add("boss", Role.ADMIN)
    client = house.client()
    await logged_in(client, provider)
    page = (await client.get("/account")).text
    assert "You log in with the company account" in page
    assert 'name="present"' not in page
    new = {"present": "", "password": "a new long one", "again": "a new long one"}
    refused = await client.post("/account/password", data=new)
    assert (refused.status_code, "no password here" in refused.text) == (403, True)
    admin = house.client()
    await admin.post("/login", data={"name": "boss", "password": PASSWORD})
    for path, data, text in (
        ("/users/anna/password", {"password": "a new long one"}, "no password here"),
        ("/users/anna/role", {"role": "admin"}, "follows the groups of the company account"),
    ):
        response = await admin.post(path, data=data)
        assert (response.status_code, text in response.text) == (422, True)
    page = (await admin.get("/users")).text
    assert "company account" in page
    assert 'action="/users/anna/role"' not in page
    assert 'action="/users/anna/password"' not in page
    assert "adds the user again" in (await admin.get("/users/anna/remove")).text
    for password in ("", "x", PASSWORD):
        response = await house.client().post("/login", data={"name": "anna", "password": password})
        assert (response.status_code, "wrong name or password" in response.text) == (401, True)
    signing = await client.get("/api/v1/shifts")
    start = signing.json()["shifts"][0]["start"]
    sign = {"part": "leaving", "name": "anna", "password": "x", "reason": "early"}
    signed_off = await admin.post(f"/api/v1/shifts/{start}/sign", json=sign)
    assert (signed_off.status_code, signed_off.json()["code"]) == (403, "forbidden")
    assert "signs in that session" in signed_off.json()["detail"]


async def test_the_last_admin_with_a_password_stays(house: House, provider: PlayedProvider) -> None:
    provider.claims = {"groups": ["line-admins"]}
    client = house.client()
    await logged_in(client, provider)
    assert "There is no user who can log in" in (await house.client().get("/login")).text
    assert (await house.client().get("/setup")).status_code == 200
    await house.add("boss", Role.ADMIN)
    assert (await house.client().get("/setup")).status_code == 303
    refused = await client.post("/users/boss/disable")
    assert (refused.status_code, "the last admin who logs in with a password is" in refused.text) == (
        422,
        True,
    )


async def test_without_a_provider_that_responds_passwords_work(tmp_path: Path) -> None:
    async with played_provider() as provider:
        settings = provider.settings(tmp_path)
    async with complete_app(tmp_path, oidc=settings) as house:
        await known(house)
        await house.add("boss", Role.ADMIN)
        client = house.client()
        page = (await client.get("/login")).text
        assert "its provider does not respond. Passwords work." in page
        assert "/login/oidc" not in page
        assert reason_of(await client.get("/login/oidc")) == "away"
        assert (await client.post("/login", data={"name": "boss", "password": PASSWORD})).status_code == 303


async def test_without_the_setting_there_is_no_company_account(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        client = house.client()
        assert "company account" not in (await client.get("/login")).text
        assert reason_of(await client.get("/login/oidc")) == "away"
        assert reason_of(await client.get(CALLBACK, params={"code": "x", "state": "x"})) == "expired"


async def test_a_new_key_of_the_provider_is_read_once(house: House, provider: PlayedProvider) -> None:
    sso = house.services[SingleSignOn].provider
    assert sso is not None
    provider.keys.append(NEW_KEY)
    provider.make_token = lambda claims: signed(claims, NEW_KEY)
    before = provider.requests["jwks"]
    for _ in range(3):
        assert reason_of(await logged_in(house.client(), provider)) == "token"
    assert provider.requests["jwks"] == before
    now = sso.monotonic()
    sso.monotonic = lambda: now + 61
    client = house.client()
    await logged_in(client, provider)
    assert (await me(client))["name"] == "anna"
    provider.make_token = lambda claims: signed(claims, NEW_KEY, kid="three")
    for _ in range(3):
        assert reason_of(await logged_in(house.client(), provider)) == "token"
    assert provider.requests["jwks"] == before + 1


async def test_a_secret_in_the_form_where_the_provider_takes_no_other(
    tmp_path: Path, provider: PlayedProvider
) -> None:
    provider.metadata = {"token_endpoint_auth_methods_supported": ["client_secret_post"]}
    async with complete_app(tmp_path, oidc=provider.settings(tmp_path)) as house:
        await known(house)
        client = house.client()
        await logged_in(client, provider)
        assert (await me(client))["name"] == "anna"


async def test_a_signed_in_browser_goes_to_its_page(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    response = await client.get("/login/oidc?next=/events")
    assert (response.status_code, response.headers["location"]) == (303, "/events")


async def test_the_provider_is_verified_by_its_certificate(tmp_path: Path) -> None:
    made = certificate(tmp_path)
    async with played_provider(server_context(made)) as provider:
        stranger = Provider(provider.settings(tmp_path))
        await stranger.refresh()
        assert "self-signed certificate" in str(stranger.fault)
        trusted = Provider(provider.settings(tmp_path, ca_file=made))
        await trusted.refresh()
        assert trusted.fault is None
        provider.metadata = {"token_endpoint": "http://127.0.0.1/token"}
        await trusted.refresh()
        assert "without https" in str(trusted.fault)
        absent = Provider(provider.settings(tmp_path, ca_file=tmp_path / "absent.pem"))
        await absent.refresh()
        assert "cannot be used" in str(absent.fault)
        for each in (stranger, trusted, absent):
            await each.close()


async def test_an_absent_secret_signs_no_one_in(house: House, provider: PlayedProvider) -> None:
    settings = house.services[SingleSignOn].settings
    assert settings is not None
    settings.client_secret_file.unlink()
    assert reason_of(await logged_in(house.client(), provider)) == "provider"
    settings.client_secret_file.write_text("another")
    assert reason_of(await logged_in(house.client(), provider)) == "provider"


OIDC = '[oidc]\nissuer = "{issuer}"\nclient_id = "lineside"\nclient_secret_file = "oidc.secret"\n'


ROLES = 'roles = { "line-operators" = "operator" }\n'


def written(folder: Path, text: str) -> Path:
    file = folder / "lineside.toml"
    file.write_text(text)
    return file


def test_the_contract(tmp_path: Path) -> None:
    settings = load(written(tmp_path, OIDC.format(issuer="https://login.plant.example/realm") + ROLES)).oidc
    assert settings is not None
    assert settings.client_secret_file == tmp_path / "oidc.secret"
    assert settings.roles == {"line-operators": "operator"}
    assert (settings.groups_claim, settings.name_claim) == ("groups", "preferred_username")
    assert load(written(tmp_path, "")).oidc is None


@for_each(
    ("issuer", "others", "text"),
    [
        ("http://login.plant.example", ROLES, "https://"),
        ("ftp://login.plant.example", ROLES, "https:// or http://"),
        ("https://login.plant.example?x", ROLES, "without a question mark"),
        ("https://me:secret@login.plant.example", ROLES, "password"),
        ("https://login.plant.example", "", "roles"),
        ("https://login.plant.example", 'roles = { "x" = "worker" }\n', "viewer"),
        ("https://login.plant.example", ROLES + 'scopes = ["profile"]\n', "openid"),
        ("https://login.plant.example", ROLES + "secret = 1\n", "secret"),
    ],
)
def test_a_fault_is_named(tmp_path: Path, issuer: str, others: str, text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"lineside\.toml") as raised:
        load(written(tmp_path, OIDC.format(issuer=issuer) + others))
    assert text in str(raised.value)


async def test_without_the_package_the_server_does_not_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(single_sign_on, "find_spec", lambda _: None)
    async with played_provider() as provider:
        settings = provider.settings(tmp_path)
    with pytest.raises(StartError, match=r"pip install lineside\[oidc\]"):
        async with complete_app(tmp_path, oidc=settings):
            raise AssertionError("it has started")
    [missing] = oidc(Settings.model_construct(oidc=settings))
    assert missing.is_fault


async def test_check_names_the_secret_and_the_provider(tmp_path: Path) -> None:
    import asyncio

    async with played_provider() as provider:
        settings = provider.settings(tmp_path)
        settings.client_secret_file.chmod(0o604)

        def texts() -> list[tuple[bool, str]]:
            return [
                (each.is_fault, str(each.message)) for each in oidc(Settings.model_construct(oidc=settings))
            ]

        found = await asyncio.to_thread(texts)
        assert [is_fault for is_fault, _ in found] == [False, False]
        assert "can be read by every user of this machine" in found[0][1]
        assert found[1][1] == f"provider of company accounts {provider.issuer} responds"
        assert SECRET not in str(found)
        settings.client_secret_file.unlink()
        provider.metadata = {"issuer": "https://other.example"}
        found = await asyncio.to_thread(texts)
        assert [is_fault for is_fault, _ in found] == [True, True]
        assert "cannot be read" in found[0][1]
        assert "of the issuer https://other.example; write issuer in [oidc] exactly so" in found[1][1]
    refused = await asyncio.to_thread(texts)
    assert "is not reached" in refused[1][1]
