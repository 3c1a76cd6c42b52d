"""Attacks on the login with the company account: by a browser, another site, and a provider gone bad."""

from __future__ import annotations

import asyncio
import gzip
import hmac
import json
from base64 import urlsafe_b64encode
from collections.abc import AsyncIterator, Callable
from typing import Any

import httpx
import pytest
from joserfc.jwk import ECKey, RSAKey

from app.core.web.access import SESSION
from app.people.auth import single_sign_on
from app.people.auth.accounts import Accounts
from app.people.auth.pages import ATTEMPT_COOKIE
from app.people.auth.provider import MAX_BYTES, InvalidTokenError, PublishedKeys, verified_claims
from app.people.auth.single_sign_on import SingleSignOn
from bus.instants import UnixTime
from tests.app.complete_app import House
from tests.app.played_provider import (
    CALLBACK,
    CLIENT,
    KEY,
    PlayedProvider,
    house_with_provider,
    known,
    logged_in,
    provider_alone,
    reason_of,
    sent,
    signed,
)
from tests.for_each import for_each

ISSUER = "https://login.plant.example"
NOW = 1_800_000_000
CLAIMS = {
    "iss": ISSUER,
    "aud": CLIENT,
    "sub": "1",
    "iat": NOW,
    "exp": NOW + 300,
    "nonce": "n",
    "preferred_username": "anna",
}
JWKS = [KEY.as_dict(private=False)]


provider = pytest.fixture(provider_alone)
house_before = pytest.fixture(house_with_provider)


@pytest.fixture
async def house(house_before: House) -> AsyncIterator[House]:
    """In the end no attack has made a user."""
    yield house_before
    assert await house_before.services[Accounts].users() == []


def verify(token: str, keys: list[Any] = JWKS) -> Any:
    usable, now = PublishedKeys(keys).usable(), UnixTime(float(NOW))
    return verified_claims(token, usable, issuer=ISSUER, client_id=CLIENT, nonce="n", now=now)


def unsigned(claims: dict[str, Any], **header: Any) -> str:
    parts = (json.dumps(each).encode() for each in ({"alg": "none", **header}, claims))
    return ".".join(urlsafe_b64encode(each).rstrip(b"=").decode() for each in parts) + "."


def by_public_key(claims: dict[str, Any]) -> str:
    """Signed with the public key as if it were a shared secret."""
    text = unsigned(claims, alg="HS256", kid="one").rstrip(".")
    seal = hmac.digest(KEY.as_pem(private=False), text.encode(), "sha256")
    return f"{text}.{urlsafe_b64encode(seal).rstrip(b'=').decode()}"


FORGED: dict[str, Callable[[dict[str, Any]], str]] = {
    "not signed": unsigned,
    "not signed, under the name of the key": lambda claims: unsigned(claims, kid="one"),
    "by the public key": by_public_key,
    "by another key of the same name": lambda c: signed(c, ECKey.generate_key("P-256", {"kid": "one"})),
    "by another kind of key": lambda c: signed(c, RSAKey.generate_key(2048, {"kid": "one"}), "RS256"),
    "by a key of another name": lambda c: signed(c, ECKey.generate_key("P-256", {"kid": "none of them"})),
    "changed": lambda c: signed(c)[:-4] + "AAAA",
    "with a condition": lambda c: signed(c, crit=["unknown"], unknown=True),
    "no token": lambda _: "x.y.z",
    "two parts": lambda _: "x.y",
    "nothing": lambda _: "",
    "no claims": lambda _: signed([]),  # type: ignore[arg-type]
}


def test_an_honest_token_is_accepted() -> None:
    assert verify(signed(CLAIMS))["sub"] == "1"
    assert verify(signed(CLAIMS, typ="JWT", x="unknown"))["sub"] == "1"
    assert verify(signed({**CLAIMS, "aud": [CLIENT, "other"], "azp": CLIENT}))["sub"] == "1"
    assert verify(signed({**CLAIMS, "exp": NOW - 59, "iat": NOW + 59, "nbf": NOW + 59}))["sub"] == "1"
    unnamed = [{key: value for key, value in JWKS[0].items() if key != "kid"}]
    assert verify(signed(CLAIMS), [{**JWKS[0], "use": "sig"}])["sub"] == "1"
    assert verify(signed(CLAIMS, ECKey.import_key({**KEY.as_dict(private=True), "kid": "one"})))["sub"] == "1"
    with pytest.raises(InvalidTokenError):
        verify(signed(CLAIMS), unnamed)


@for_each("name", FORGED)
def test_a_forged_token_is_refused(name: str) -> None:
    with pytest.raises(InvalidTokenError):
        verify(FORGED[name](CLAIMS))


@for_each(
    "keys",
    [
        [],
        [{}],
        [{"kty": "EC", "kid": "one"}],
        [{"kty": "EC", "kid": "one", "crv": "P-256", "x": "!", "y": 7}],
        [{**JWKS[0], "use": "enc"}],
        [{**JWKS[0], "alg": "ES512"}],
        [{"kty": "oct", "kid": "one", "k": "c2VjcmV0" * 4}],
    ],
)
def test_a_token_without_its_key_is_refused(keys: list[Any]) -> None:
    with pytest.raises(InvalidTokenError):
        verify(signed(CLAIMS), keys)


@for_each(
    "wrong",
    [
        *({"iss": iss} for iss in (f"{ISSUER}/", None)),
        *({"aud": aud} for aud in ("other", ["other"], [CLIENT, "other"], {CLIENT: True}, None)),
        {"azp": "other"},
        *({"exp": exp} for exp in (NOW - 60, None, True, "2099")),
        *({"iat": iat} for iat in (NOW + 61, None)),
        {"nbf": NOW + 61},
        *({"nonce": nonce} for nonce in ("of another", None, 7)),
        *({"sub": sub} for sub in (None, "", 7, "x" * 256)),
    ],
)
def test_a_token_for_another_case_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidTokenError):
        verify(signed({key: value for key, value in {**CLAIMS, **wrong}.items() if value is not None}))


async def test_a_forged_token_of_the_provider_signs_no_one_in(house: House, provider: PlayedProvider) -> None:
    client = house.client()
    for name in ("not signed", "by the public key", "by another key of the same name"):
        provider.make_token = FORGED[name]
        assert reason_of(await logged_in(client, provider)) == "token"
        assert SESSION not in client.cookies
    refused = await house.events("login_refused")
    assert refused[0]["what"] == "login with a company account refused"


async def test_a_way_back_is_of_its_browser_and_taken_once(house: House, provider: PlayedProvider) -> None:
    """Another site sends a browser to the callback with an own code (RFC 6749, 10.12)."""
    attacker, victim = house.client(), house.client()
    forged = provider.login(await sent(attacker))
    assert reason_of(await victim.get(CALLBACK, params=forged)) == "expired"
    own = provider.login(await sent(victim))
    assert reason_of(await victim.get(CALLBACK, params=forged)) == "expired"
    assert ATTEMPT_COOKIE not in victim.cookies
    assert reason_of(await victim.get(CALLBACK, params=own)) == "expired"
    state = provider.login(await sent(victim))["state"]
    assert reason_of(await victim.get(CALLBACK, params={**forged, "state": state})) == "provider"
    for cookie in ("", "x", "W10", "x" * 5000):
        planted = house.client(cookie=f"{ATTEMPT_COOKIE}={cookie}")
        assert reason_of(await planted.get(CALLBACK, params={"code": "x", "state": ""})) == "expired"
    assert provider.requests["token"] == 1


async def test_the_response_of_another_issuer(house: House, provider: PlayedProvider) -> None:
    """RFC 9207: a mix-up of two providers."""
    client = house.client()
    for issuer in ("https://evil.example", f"{provider.issuer}/", ""):
        back = {**provider.login(await sent(client)), "iss": issuer}
        assert reason_of(await client.get(CALLBACK, params=back)) == "token"
    provider.metadata = {"authorization_response_iss_parameter_supported": True}
    await known(house)
    back = provider.login(await sent(client))
    del back["iss"]
    assert reason_of(await client.get(CALLBACK, params=back)) == "token"
    assert provider.requests["token"] == 0


async def test_a_login_leads_to_own_pages_only(house: House, provider: PlayedProvider) -> None:
    provider.claims = {"groups": []}
    elsewhere = ("https://evil.example", "//evil.example", "/\\evil.example", "evil", "/x\r\nX: y")
    for page in (*elsewhere, "/" + "x" * 2000):
        client = house.client()
        response = await client.get(CALLBACK, params=provider.login(await sent(client, page)))
        assert response.headers["location"] == "/login?company_account=groups"


async def test_what_the_provider_reports_is_not_shown(house: House, provider: PlayedProvider) -> None:
    client = house.client()
    for error, reason in (("access_denied", "canceled"), ("<script>", "provider"), ("", "provider")):
        back = {"state": provider.login(await sent(client))["state"], "error": error}
        response = await client.get(CALLBACK, params={**back, "error_description": "<script>"})
        assert reason_of(response) == reason
    for code in ("", "x" * 5000):
        back = {"state": provider.login(await sent(client))["state"], "code": code}
        assert reason_of(await client.get(CALLBACK, params=back)) == "provider"
    page = await client.get("/login?company_account=<script>alert(1)</script>")
    assert "<script>alert" not in page.text
    assert provider.requests["token"] == 0


async def test_a_provider_that_responds_with_anything(house: House, provider: PlayedProvider) -> None:
    sso = house.services[SingleSignOn].provider
    assert sso is not None
    honest = json.dumps(provider._metadata()).encode()
    in_clear = honest.replace(b"http://", b"ftp://")
    for status, content in (
        (200, b"x" * (MAX_BYTES + 1)),
        (200, b"[" * 100_000),
        (200, b"{}"),
        (200, b"\xff"),
        (200, honest.replace(b'"issuer": "http', b'"issuer": "https')),
        (200, in_clear.replace(b'"issuer": "ftp', b'"issuer": "http')),
        (500, honest),
        (302, honest),
    ):
        provider.responses["openid-configuration"] = (status, content)
        await known(house)
        assert sso.fault is not None
        assert reason_of(await house.client().get("/login/oidc")) == "away"
    del provider.responses["openid-configuration"]
    provider.responses["jwks"] = (200, json.dumps({"keys": [{}] * 101}).encode())
    await known(house)
    assert sso.fault is not None
    del provider.responses["jwks"]
    await known(house)
    assert sso.fault is None
    client = house.client()
    for content in (b"x" * (MAX_BYTES + 1), b"[" * 100_000, b"[]", b'{"expires_in": Infinity}'):
        provider.responses["token"] = (200, content)
        assert reason_of(await logged_in(client, provider)) == "away"
        await known(house)
    for status, content in (
        (503, b"<html>"),
        (429, b"<html>"),
        (400, b'{"message": "no"}'),
        (400, b'{"error": ["no"]}'),
        (200, b'{"id_token": 7}'),
        (200, b"{}"),
    ):
        provider.responses["token"] = (status, content)
        assert reason_of(await logged_in(client, provider)) == "provider"
        assert sso.fault is None


async def test_nothing_that_the_provider_packs_is_unpacked(house: House, provider: PlayedProvider) -> None:
    """A kilobyte could be a gigabyte."""
    sso = house.services[SingleSignOn].provider
    assert sso is not None
    provider.header = "Content-Encoding: gzip\r\n"
    provider.responses["openid-configuration"] = (
        200,
        gzip.compress(json.dumps(provider._metadata()).encode()),
    )
    await known(house)
    assert "something that is not of OpenID Connect" in str(sso.fault)
    del provider.responses["openid-configuration"]
    await known(house)
    assert sso.fault is None, "it is read as it came, whatever its header states"
    provider.responses["token"] = (200, gzip.compress(b" " * 100 * MAX_BYTES + b"{}"))
    assert reason_of(await logged_in(house.client(), provider)) == "away"


async def test_made_up_codes_of_one_address_are_bounded(house: House, provider: PlayedProvider) -> None:
    def made_up(url: str) -> dict[str, str]:
        return {**provider.login(url), "code": "made up"}

    client = house.client()
    reasons = [reason_of(await client.get(CALLBACK, params=made_up(await sent(client)))) for _ in range(12)]
    assert reasons == ["provider"] * single_sign_on.FAILURES + ["busy"] * 2
    assert provider.requests["token"] == single_sign_on.FAILURES
    house.address = "192.0.2.8"
    other = house.client()
    assert reason_of(await other.get(CALLBACK, params=made_up(await sent(other)))) == "provider"


async def test_a_slow_provider_holds_no_one_up(house: House, provider: PlayedProvider) -> None:
    """However many browsers are back from it, few requests are under way, and the login page responds."""
    provider.held = {"token"}
    backs: list[asyncio.Task[httpx.Response]] = []
    for number in range(8):
        house.address = f"192.0.2.{number}"
        client = house.client()
        back = provider.login(await sent(client))
        backs.append(asyncio.create_task(client.get(CALLBACK, params=back)))
    async with asyncio.timeout(60):
        while provider.requests["token"] < single_sign_on.MAX_AT_ONCE:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    page = await house.client().get("/login")
    assert page.status_code == 200
    assert provider.requests["token"] == single_sign_on.MAX_AT_ONCE
    assert not any(each.done() for each in backs)
    provider.claims = {"groups": []}
    provider.released.set()
    assert {reason_of(await each) for each in backs} == {"groups"}


async def test_a_provider_that_never_responds_ends_in_bounded_time(
    house: House, provider: PlayedProvider, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.people.auth.provider.EXCHANGE_S", 0.05)
    provider.held = {"token"}
    client = house.client()
    assert reason_of(await logged_in(client, provider)) == "away"
    assert "its provider does not respond" in (await client.get("/login")).text
    assert reason_of(await client.get("/login/oidc")) == "away"
    monkeypatch.setattr(single_sign_on, "ALL_S", 0.05)
    monkeypatch.setattr("app.people.auth.provider.EXCHANGE_S", 8.0)
    await known(house)
    assert reason_of(await logged_in(client, provider)) == "away"
