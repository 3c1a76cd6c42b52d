"""The provider of company accounts: where it is, which keys it signs with, and whether it can be reached.

Only `watch` reads its metadata and keys, at times of its choice: however many browsers come, the provider
gets no request for them. A browser that comes back from it with a code is one request, in its turn.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated
from urllib.parse import urlencode, urlsplit

import msgspec
import structlog

from app.auth.oidc import responses
from app.auth.oidc.id_token import (
    Claims,
    Expected,
    InvalidTokenError,
    KeyData,
    UnknownKeyError,
    verified_claims,
)
from app.auth.oidc.login_attempt import LoginAttempt
from app.auth.oidc.refusal import NotAdmittedError
from app.auth.oidc.responses import FormRefusedError, ProviderError
from app.auth.settings import OidcSettings
from app.server.secret_file import SecretFileError, read_secret_text
from bus.instants import Clock, Monotonic, MonotonicClock, monotonic_now, unix_now
from bus.messages import Message

if TYPE_CHECKING:
    import httpx

REFRESH_WITHIN_S, EXCHANGE_S = 10.0, 8.0
"""How long the provider may take for its metadata and keys, and for a code."""
REFRESH_S = 300.0
FIRST_WAIT_S, MAX_WAIT_S = 2.0, 60.0
KEYS_EVERY_S = 60.0
"""For an unknown key the keys are read again, but not more often."""
MAX_KEYS = 100
WELL_KNOWN = "/.well-known/openid-configuration"

_log = structlog.get_logger()
_Url = Annotated[str, msgspec.Meta(max_length=2000)]
_BASIC = "client_secret_basic"


class Metadata(msgspec.Struct, frozen=True):
    """The used part of the metadata (OpenID Connect Discovery, 3)."""

    issuer: _Url
    authorization_endpoint: _Url
    token_endpoint: _Url
    jwks_uri: _Url
    token_endpoint_auth_methods_supported: Sequence[str] = (_BASIC,)
    authorization_response_iss_parameter_supported: bool = False


class _KeySet(msgspec.Struct):
    keys: Annotated[list[dict[str, object]], msgspec.Meta(max_length=MAX_KEYS)]


class _Tokens(msgspec.Struct):
    id_token: str


@dataclass(eq=False, repr=False)
class Provider:
    """``fault``: why no one can sign in by it now; None while it responds."""

    settings: OidcSettings
    clock: Clock = unix_now
    monotonic: MonotonicClock = monotonic_now
    fault: Message | None = field(default_factory=lambda: Message("provider_not_read_yet"))
    _metadata: Metadata | None = None
    _keys: Sequence[KeyData] = ()
    _keys_at: Monotonic = Monotonic(float("-inf"))
    _client: httpx.AsyncClient | None = None
    _reading_keys: asyncio.Lock = field(default_factory=asyncio.Lock)
    _failed: asyncio.Event = field(default_factory=asyncio.Event)

    async def watch(self) -> None:
        """Run until canceled: read the metadata and keys every five minutes, and after a failure sooner."""
        wait_s = FIRST_WAIT_S
        while True:
            before = self.fault
            await self.refresh()
            if self.fault != before:
                _log.info("provider of company accounts", issuer=self.settings.issuer, fault=self.fault)
            wait_s = FIRST_WAIT_S if self.fault is None else min(2 * wait_s, MAX_WAIT_S)
            self._failed.clear()
            await asyncio.sleep(wait_s)
            if self.fault is None:
                with suppress(TimeoutError):
                    async with asyncio.timeout(REFRESH_S):
                        await self._failed.wait()

    async def refresh(self) -> None:
        """Read the metadata and the keys now. What was read before is kept where that fails."""
        try:
            async with asyncio.timeout(REFRESH_WITHIN_S):
                metadata = await self._read_metadata()
                await self._read_keys(metadata)
        except ProviderError as error:
            self.fault = error.message
        except TimeoutError:
            self.fault = Message.of("provider_timed_out", url=self.settings.issuer)
        else:
            self._metadata, self.fault = metadata, None

    def login_url(self, attempt: LoginAttempt, callback: str, *, reauthenticate: bool) -> str | None:
        """Where a browser goes to sign in; None while the provider is not known. ``reauthenticate``: the
        person is to sign in there again."""
        if self._metadata is None:
            return None
        query = {
            "response_type": "code",
            "client_id": self.settings.client_id,
            "redirect_uri": callback,
            "scope": " ".join(self.settings.scopes),
            "state": attempt.state,
            "nonce": attempt.nonce,
            "code_challenge": attempt.challenge,
            "code_challenge_method": "S256",
            **({"prompt": "login"} if reauthenticate else {}),
        }
        endpoint = self._metadata.authorization_endpoint
        return f"{endpoint}{'&' if urlsplit(endpoint).query else '?'}{urlencode(query)}"

    def is_issuer(self, issuer: str | None) -> bool:
        """Whether the way back names this provider (RFC 9207, 2.4)."""
        if issuer is None:
            must_name = (
                self._metadata is not None and self._metadata.authorization_response_iss_parameter_supported
            )
            return not must_name
        return issuer == self.settings.issuer

    async def claims(self, code: str, attempt: LoginAttempt, callback: str) -> Claims:
        """Redeem a code for an ID token, and verify that. Raises NotAdmittedError."""
        if self._metadata is None:
            raise NotAdmittedError("away")
        try:
            async with asyncio.timeout(EXCHANGE_S):
                return await self._claims(self._metadata, code, attempt, callback)
        except InvalidTokenError as error:
            raise NotAdmittedError("token", str(error)) from None
        except (FormRefusedError, SecretFileError) as error:
            raise NotAdmittedError("provider", str(error)) from None
        except (ProviderError, TimeoutError) as error:
            timed_out = Message.of("provider_timed_out", url=self._metadata.token_endpoint)
            self.fault = error.message if isinstance(error, ProviderError) else timed_out
            self._failed.set()
            raise NotAdmittedError("away", str(self.fault)) from None

    async def close(self) -> None:
        """Close the connections."""
        if self._client is not None:
            await self._client.aclose()

    async def _claims(self, metadata: Metadata, code: str, attempt: LoginAttempt, callback: str) -> Claims:
        token = await self._redeem(metadata, code, attempt.verifier, callback)
        expected = Expected(self.settings.issuer, self.settings.client_id, attempt.nonce)
        with suppress(UnknownKeyError):
            return verified_claims(token, self._keys, expected, self.clock())
        await self._read_keys_again(metadata)
        return verified_claims(token, self._keys, expected, self.clock())

    async def _redeem(self, metadata: Metadata, code: str, verifier: str, callback: str) -> str:
        secret, client_id = read_secret_text(self.settings.client_secret_file), self.settings.client_id
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": callback,
            "code_verifier": verifier,
        }
        basic = (client_id, secret) if _BASIC in metadata.token_endpoint_auth_methods_supported else None
        if basic is None:
            form |= {"client_id": client_id, "client_secret": secret}
        tokens = await responses.post(self._open_client(), metadata.token_endpoint, form, _Tokens, basic)
        return tokens.id_token

    async def _read_metadata(self) -> Metadata:
        url = self.settings.issuer.rstrip("/") + WELL_KNOWN
        metadata = await responses.get(self._open_client(), url, Metadata)
        if metadata.issuer != self.settings.issuer:
            found = metadata.issuer[:200]
            raise ProviderError(Message.of("provider_of_other_issuer", url=url, found=found))
        is_in_clear = urlsplit(self.settings.issuer).scheme == "http"
        schemes = ("https", "http") if is_in_clear else ("https",)
        for endpoint in (metadata.authorization_endpoint, metadata.token_endpoint, metadata.jwks_uri):
            if not endpoint.startswith(tuple(f"{scheme}://" for scheme in schemes)):
                raise ProviderError(Message.of("provider_in_clear", url=url))
        return metadata

    async def _read_keys(self, metadata: Metadata) -> None:
        self._keys_at = self.monotonic()
        self._keys = (await responses.get(self._open_client(), metadata.jwks_uri, _KeySet)).keys

    async def _read_keys_again(self, metadata: Metadata) -> None:
        """For a token with a new key: one request, however many such tokens come."""
        async with self._reading_keys:
            if self.monotonic() - self._keys_at >= KEYS_EVERY_S:
                await self._read_keys(metadata)

    def _open_client(self) -> httpx.AsyncClient:
        if self._client is None:
            ca_file = self.settings.ca_file
            self._client = responses.new_client(None if ca_file is None else str(ca_file))
        return self._client
