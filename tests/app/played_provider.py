"""A provider of company accounts on this machine that a test makes honest, wrong, slow or malicious."""

from __future__ import annotations

import asyncio
import json
import ssl
from base64 import b64decode, urlsafe_b64encode
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from time import time
from typing import Any
from urllib.parse import parse_qs, parse_qsl, urlsplit

import httpx
from joserfc import jws
from joserfc.jwk import ECKey, OctKey

from app.people.auth.settings import OidcSettings
from app.people.auth.single_sign_on import SingleSignOn
from tests.app.complete_app import HOST, House, complete_app
from tests.app.notification_servers import listening

CLIENT, SECRET = "lineside", "a secret: of the provider"
GROUPS = {"line-viewers": "viewer", "line-operators": "operator", "line-admins": "admin"}
CALLBACK = "/login/oidc/callback"
KEY = ECKey.generate_key("P-256", {"kid": "one"})
NEW_KEY = ECKey.generate_key("P-256", {"kid": "two"})


@dataclass
class PlayedProvider:
    """``claims``: added to those of the person, or in their place. ``make_token``: instead of an honest one.
    ``responses``: of a path, instead of the honest response: its status and content. ``header``: one more
    line of every response. ``held``: the paths that do not respond before ``released``."""

    port: int = 0
    scheme: str = "http"
    claims: dict[str, Any] = field(default_factory=dict)
    keys: list[Any] = field(default_factory=lambda: [KEY])
    make_token: Callable[[dict[str, Any]], str] | None = None
    metadata: dict[str, Any] = field(default_factory=dict)
    responses: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    header: str = ""
    held: set[str] = field(default_factory=set)
    released: asyncio.Event = field(default_factory=asyncio.Event)
    requests: Counter[str] = field(default_factory=Counter)
    issued: int = 0
    codes: dict[str, dict[str, str]] = field(default_factory=dict)

    @property
    def issuer(self) -> str:
        return f"{self.scheme}://127.0.0.1:{self.port}/realm"

    def settings(self, folder: Path, **others: Any) -> OidcSettings:
        """``[oidc]`` of a site that has this provider."""
        file = folder / "oidc.secret"
        file.write_text(f"{SECRET}\n")
        return OidcSettings(
            issuer=self.issuer, client_id=CLIENT, client_secret_file=file, roles=GROUPS, **others
        )

    def login(self, url: str) -> dict[str, str]:
        """What the browser brings back from the provider, once the person has signed in there."""
        query = dict(parse_qsl(urlsplit(url).query))
        assert url.startswith(f"{self.issuer}/authorize?")
        assert query["response_type"] == "code"
        assert query["code_challenge_method"] == "S256"
        assert query["redirect_uri"].endswith(f"://{HOST}{CALLBACK}")
        self.issued += 1
        code = f"code-{self.issued}"
        self.codes[code] = query
        return {"code": code, "state": query["state"], "iss": self.issuer}

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = (await reader.readuntil(b"\r\n\r\n")).decode()
        path = head.split()[1]
        headers = {
            name.lower(): value for name, _, value in (each.partition(": ") for each in head.split("\r\n"))
        }
        body = await reader.readexactly(int(headers.get("content-length", "0")))
        name = path.rpartition("/")[2]
        self.requests[name] += 1
        if name in self.held:
            await self.released.wait()
        status, content = self.responses.get(name) or self._respond(name, headers, body)
        writer.write(
            f"HTTP/1.1 {status} x\r\nContent-Length: {len(content)}\r\nConnection: close\r\n"
            f"{self.header}\r\n".encode()
        )
        writer.write(content)
        await writer.drain()

    def _respond(self, name: str, headers: dict[str, str], body: bytes) -> tuple[int, bytes]:
        match name:
            case "openid-configuration":
                return 200, json.dumps(self._metadata()).encode()
            case "jwks":
                return 200, json.dumps({"keys": [each.as_dict(private=False) for each in self.keys]}).encode()
            case "token":
                return self._redeem(
                    headers, {key: values[0] for key, values in parse_qs(body.decode()).items()}
                )
        return 404, b""

    def _metadata(self) -> dict[str, Any]:
        there = {f"{each}_endpoint": f"{self.issuer}/{path}" for each, path in _ENDPOINTS.items()}
        return {"issuer": self.issuer, "jwks_uri": f"{self.issuer}/jwks", **there, **self.metadata}

    def _redeem(self, headers: dict[str, str], form: dict[str, str]) -> tuple[int, bytes]:
        """A code is redeemed once, by its client, with the verifier of its challenge."""
        query = self.codes.pop(form["code"], None)
        given = b64decode(headers.get("authorization", "").removeprefix("Basic ")).decode()
        challenge = urlsafe_b64encode(sha256(form["code_verifier"].encode()).digest()).rstrip(b"=").decode()
        if (
            query is None
            or (given or f"{form.get('client_id')}:{form.get('client_secret')}") not in _CLIENTS
            or challenge != query["code_challenge"]
            or form["redirect_uri"] != query["redirect_uri"]
        ):
            return 400, b'{"error": "invalid_grant"}'
        claims = {
            "iss": self.issuer,
            "aud": CLIENT,
            "sub": "248289761001",
            "iat": int(time()),
            "exp": int(time()) + 300,
            "nonce": query["nonce"],
            "preferred_username": "anna",
            "groups": ["line-operators"],
            **self.claims,
        }
        claims = {key: value for key, value in claims.items() if value is not None}
        token = self.make_token(claims) if self.make_token else signed(claims)
        return 200, json.dumps({"access_token": "x", "token_type": "Bearer", "id_token": token}).encode()


_ENDPOINTS = {"authorization": "authorize", "token": "token"}
_CLIENTS = (f"{CLIENT}:{SECRET}", f"{CLIENT}:a+secret%3A+of+the+provider")


class _AnyHeader(jws.JWSRegistry):
    def check_header(self, header: object) -> None:
        """Sign each header."""


def signed(claims: dict[str, Any], key: Any = KEY, alg: str = "ES256", **header: Any) -> str:
    """A token of these claims, also one that no honest provider makes."""
    registry = _AnyHeader(algorithms=[alg])
    named = {"kid": key.kid} if key is not None and not isinstance(key, OctKey) else {}
    return jws.serialize_compact({"alg": alg, **named, **header}, json.dumps(claims), key, registry=registry)


@asynccontextmanager
async def played_provider(context: ssl.SSLContext | None = None) -> AsyncIterator[PlayedProvider]:
    """A provider that responds until the end, by TLS with a ``context``."""
    provider = PlayedProvider(scheme="http" if context is None else "https")
    async with listening(provider.serve, context) as provider.port:
        yield provider


async def provider_alone() -> AsyncIterator[PlayedProvider]:
    """A fixture: a provider in clear."""
    async with played_provider() as provider:
        yield provider


async def house_with_provider(tmp_path: Path, provider: PlayedProvider) -> AsyncIterator[House]:
    """A fixture: an app that knows this provider."""
    async with complete_app(tmp_path, oidc=provider.settings(tmp_path)) as house:
        await known(house)
        yield house


async def known(house: House) -> None:
    """Have the server of a house read its provider now."""
    provider = house.services[SingleSignOn].provider
    assert provider is not None
    await provider.refresh()


async def sent(client: httpx.AsyncClient, next_page: str = "/") -> str:
    """To where the login with the company account leads a browser."""
    response = await client.get("/login/oidc", params={"next": next_page})
    assert response.status_code == 303
    return response.headers["location"]


async def logged_in(client: httpx.AsyncClient, provider: PlayedProvider) -> httpx.Response:
    """The response to a browser that has been at the provider."""
    return await client.get(CALLBACK, params=provider.login(await sent(client)))


def reason_of(response: httpx.Response) -> str:
    """Why a company account was not admitted."""
    assert response.status_code == 303, response.text
    location = urlsplit(response.headers["location"])
    assert location.path == "/login", location
    return parse_qs(location.query)["company_account"][0]
