"""The provider of company accounts: its addresses and keys, and the claims for which it exchanges a code.

Authlib speaks OpenID Connect: the address of a login, the redemption of a code, the claims of an ID token.
The parts that it leaves to its caller are here: how much is read, how long that may take, and when.

Only `Provider.watch` reads metadata and keys, at times of its choice: however many browsers come, the
provider gets no request for them. For each browser that returns from it with a code there is one request,
made when its turn comes.
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeVar
from urllib.parse import quote_plus, urlsplit

import httpx2
import msgspec
import structlog
from authlib.integrations.httpx_client import AsyncOAuth2Client, OAuth2ClientAuth, OAuthError
from authlib.oidc.core import CodeIDToken
from authlib.oidc.discovery import get_well_known_url
from joserfc import jwt
from joserfc.errors import ClaimError, InvalidKeyIdError, JoseError
from joserfc.jwk import KeySet, import_key
from joserfc.jws import JWSRegistry

from app.core.server.settings import SecretFileError, read_secret_text
from app.errors import network_cause, system_error
from app.people.auth.login_attempt import LoginAttempt, NotAdmittedError, printable
from app.people.auth.settings import OidcSettings
from bus.errors import LinesideError
from bus.instants import Monotonic, MonotonicClock, UnixTime, monotonic_now, unix_now
from bus.messages import Message

REFRESH_WITHIN_S, EXCHANGE_S = 10.0, 8.0
"""The seconds that the provider may take for its metadata and keys, and for a code."""
SOCKET_S = 5.0
MAX_CONNECTIONS = 6
MAX_BYTES = 256 * 1024
"""The most bytes of a response. The keys of Entra ID are 20 KB."""
MAX_KEYS = 100
REFRESH_S = 300.0
FIRST_WAIT_S, MAX_WAIT_S = 2.0, 60.0
KEYS_EVERY_S = 60.0
"""The seconds before the keys are read again for an unknown key."""
LEEWAY_S = 60.0
"""The most seconds by which the clocks of provider and server may differ."""
MAX_SUBJECT = 255
_SIGNED = JWSRegistry(
    algorithms=[
        *("RS256", "RS384", "RS512", "PS256", "PS384", "PS512"),
        *("ES256", "ES384", "ES512", "EdDSA", "Ed25519"),
    ],
    strict_check_header=False,
)
"""Signatures by a key that only the provider has: neither ``none``, nor by a shared secret."""
_BASIC, _POST = "client_secret_basic", "client_secret_post"
_HEADERS = {"Accept": "application/json", "Accept-Encoding": "identity", "User-Agent": "lineside"}

_log = structlog.get_logger()
_Url = Annotated[str, msgspec.Meta(max_length=2000)]
T = TypeVar("T")
Claims = Mapping[str, Any]


class ProviderError(LinesideError):
    """Raised when the provider cannot be used now. The text holds nothing that the provider wrote."""


class InvalidTokenError(Exception):
    """Raised for an ID token that is refused. The text is for the log: of the token it holds only names."""


class UnknownKeyError(InvalidTokenError):
    """Raised for a token that is signed by none of the known keys: the provider may have a new one."""


class Metadata(msgspec.Struct, frozen=True):
    """The used part of the metadata (OpenID Connect Discovery, 3)."""

    issuer: _Url
    authorization_endpoint: _Url
    token_endpoint: _Url
    jwks_uri: _Url
    token_endpoint_auth_methods_supported: Sequence[str] = (_BASIC,)
    authorization_response_iss_parameter_supported: bool = False


class PublishedKeys(msgspec.Struct):
    """The keys of a provider (RFC 7517, 5)."""

    keys: Annotated[list[dict[str, Any]], msgspec.Meta(max_length=MAX_KEYS)]

    def usable(self) -> KeySet:
        """Return the keys that can be read; a provider may publish others beside them."""
        found = []
        for each in self.keys:
            with suppress(JoseError, ValueError, TypeError, KeyError):
                found.append(import_key(each))
        return KeySet(found)


def verified_claims(
    token: str, keys: KeySet, *, issuer: str, client_id: str, nonce: str, now: UnixTime
) -> Claims:
    """Return the claims of an ID token of this issuer, for this client, for the attempt with this nonce
    (OpenID Connect Core, 3.1.3.7). Raise InvalidTokenError."""
    options = {"iss": {"value": issuer}, "aud": {"value": client_id}, "sub": {"essential": True}}
    try:
        signed = jwt.decode(token, keys, registry=_SIGNED)
        claims = CodeIDToken(signed.claims, signed.header, options, {"nonce": nonce, "client_id": client_id})
        claims.validate(now=float(now), leeway=LEEWAY_S)
    except InvalidKeyIdError:
        raise UnknownKeyError("it is signed by a key that the provider does not name") from None
    except ClaimError as error:
        advice = "; compare the clocks of server and provider" if error.claim in ("exp", "iat", "nbf") else ""
        raise InvalidTokenError(f"its claim {error.claim} is refused{advice}") from None
    except (JoseError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise InvalidTokenError(f"its signature is not valid: {type(error).__name__}") from None
    if len(claims["sub"]) > MAX_SUBJECT:
        raise InvalidTokenError("its subject is too long")
    return dict(claims)


@dataclass(eq=False, repr=False)
class Provider:
    """The provider as this server knows it. ``fault``: why no one can sign in by it now; None while it
    responds."""

    settings: OidcSettings
    monotonic: MonotonicClock = monotonic_now
    fault: Message | None = field(default_factory=lambda: Message("provider_not_read_yet"))
    _metadata: Metadata | None = None
    _keys: KeySet = field(default_factory=lambda: KeySet([]))
    _keys_at: Monotonic = Monotonic(float("-inf"))
    _client: AsyncOAuth2Client | None = None
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
        """Read the metadata and the keys now. After a failure the earlier ones are kept."""
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
        """Return where a browser goes to sign in; None while the provider is not known. ``reauthenticate``:
        whether the person has to sign in there again."""
        if self._metadata is None:
            return None
        url, _ = self._open_client().create_authorization_url(
            self._metadata.authorization_endpoint,
            state=attempt.state,
            nonce=attempt.nonce,
            code_verifier=attempt.verifier,
            redirect_uri=callback,
            prompt="login" if reauthenticate else None,
        )
        return str(url)

    def is_issuer(self, issuer: str | None) -> bool:
        """Return whether the way back names this provider (RFC 9207, 2.4)."""
        if issuer is None:
            return self._metadata is None or not self._metadata.authorization_response_iss_parameter_supported
        return issuer == self.settings.issuer

    async def claims(self, code: str, attempt: LoginAttempt, callback: str) -> Claims:
        """Redeem a code for an ID token, and verify it. Raise NotAdmittedError."""
        if self._metadata is None:
            raise NotAdmittedError("away")
        try:
            async with asyncio.timeout(EXCHANGE_S):
                return await self._claims(self._metadata, code, attempt, callback)
        except InvalidTokenError as error:
            raise NotAdmittedError("token", str(error)) from None
        except SecretFileError as error:
            raise NotAdmittedError("provider", str(error)) from None
        except (ProviderError, TimeoutError) as error:
            timed_out = Message.of("provider_timed_out", url=self._metadata.token_endpoint)
            self.fault = error.message if isinstance(error, ProviderError) else timed_out
            self._failed.set()
            raise NotAdmittedError("away", str(self.fault)) from None

    async def close(self) -> None:
        """Close the connections to the provider."""
        if self._client is not None:
            await self._client.aclose()

    async def _claims(self, metadata: Metadata, code: str, attempt: LoginAttempt, callback: str) -> Claims:
        token = await self._redeem(metadata, code, attempt.verifier, callback)
        with suppress(UnknownKeyError):
            return self._verified(token, attempt)
        await self._read_keys_again(metadata)
        return self._verified(token, attempt)

    def _verified(self, token: str, attempt: LoginAttempt) -> Claims:
        issuer, client_id = self.settings.issuer, self.settings.client_id
        return verified_claims(
            token, self._keys, issuer=issuer, client_id=client_id, nonce=attempt.nonce, now=unix_now()
        )

    async def _redeem(self, metadata: Metadata, code: str, verifier: str, callback: str) -> str:
        """Return the ID token for a code. Raise NotAdmittedError for a code that gives none, as a made-up
        one: that is no fault of the provider, and must not close it to all others."""
        credentials = (self.settings.client_id, read_secret_text(self.settings.client_secret_file))
        # RFC 6749, 2.3.1 has both encoded in the header, which Authlib leaves out.
        in_header = httpx2.BasicAuth(*map(quote_plus, credentials))
        is_basic = _BASIC in metadata.token_endpoint_auth_methods_supported
        try:
            with _reading(metadata.token_endpoint):
                tokens = await self._open_client().fetch_token(
                    metadata.token_endpoint,
                    grant_type="authorization_code",
                    code=code,
                    code_verifier=verifier,
                    redirect_uri=callback,
                    auth=in_header if is_basic else OAuth2ClientAuth(*credentials, _POST),
                )
        except OAuthError as error:
            raise NotAdmittedError("provider", printable(str(error.error))) from None
        except httpx2.HTTPStatusError as error:
            raise NotAdmittedError("provider", str(error.response.status_code)) from None
        token = tokens.get("id_token")
        if not isinstance(token, str):
            raise NotAdmittedError("provider", "no ID token")
        return token

    async def _read_metadata(self) -> Metadata:
        url = get_well_known_url(self.settings.issuer, external=True)
        metadata = await self._read(url, Metadata)
        if metadata.issuer != self.settings.issuer:
            found = metadata.issuer[:200]
            raise ProviderError(Message.of("provider_of_other_issuer", url=url, found=found))
        is_in_clear = urlsplit(self.settings.issuer).scheme == "http"
        schemes = ("https://", "http://") if is_in_clear else ("https://",)
        for endpoint in (metadata.authorization_endpoint, metadata.token_endpoint, metadata.jwks_uri):
            if not endpoint.startswith(schemes):
                raise ProviderError(Message.of("provider_in_clear", url=url))
        return metadata

    async def _read_keys(self, metadata: Metadata) -> None:
        self._keys_at = self.monotonic()
        self._keys = (await self._read(metadata.jwks_uri, PublishedKeys)).usable()

    async def _read_keys_again(self, metadata: Metadata) -> None:
        """Read the keys for a token with a new one: one request, however many such tokens come."""
        async with self._reading_keys:
            if self.monotonic() - self._keys_at >= KEYS_EVERY_S:
                await self._read_keys(metadata)

    async def _read(self, url: str, kind: type[T]) -> T:
        """Read a document of the provider. Raise ProviderError."""
        with _reading(url):
            response = await self._open_client().request("GET", url, withhold_token=True)
        if response.status_code != 200:
            raise ProviderError(Message.of("provider_status", url=url, status=response.status_code))
        with _reading(url):
            return msgspec.json.decode(response.content, type=kind)

    def _open_client(self) -> AsyncOAuth2Client:
        """Return a client that leads nowhere else: no redirects, and no proxy or password of the environment.
        Raise ProviderError if the authority cannot be read."""
        if self._client is None:
            path = self.settings.ca_file
            try:
                context = ssl.create_default_context(cafile=path)
            except OSError as error:
                reason = system_error(error)
                unreadable = Message.of("provider_authority_unreadable", path=str(path), reason=reason)
                raise ProviderError(unreadable) from None
            limits = httpx2.Limits(max_connections=MAX_CONNECTIONS, max_keepalive_connections=1)
            self._client = AsyncOAuth2Client(
                self.settings.client_id,
                scope=" ".join(self.settings.scopes),
                code_challenge_method="S256",
                headers=_HEADERS,
                timeout=SOCKET_S,
                transport=_BoundedTransport(verify=context, trust_env=False, limits=limits),
                trust_env=False,
            )
        return self._client


class _BoundedTransport(httpx2.AsyncHTTPTransport):
    """A transport that reads each response completely, unmodified and up to `MAX_BYTES`. It drops the
    headers, so that nothing is unpacked, which could be of any size, and nothing is kept."""

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        response = await super().handle_async_request(request)
        assert isinstance(response.stream, httpx2.AsyncByteStream)
        content = bytearray()
        try:
            async for piece in response.stream:
                content += piece
                if len(content) > MAX_BYTES:
                    url = str(request.url)
                    raise ProviderError(Message.of("provider_response_too_large", url=url, most=MAX_BYTES))
        finally:
            await response.aclose()
        return httpx2.Response(response.status_code, content=bytes(content))


@contextmanager
def _reading(url: str) -> Iterator[None]:
    """Raise ProviderError for a provider that cannot be reached, or whose response is malformed."""
    try:
        yield
    except httpx2.HTTPStatusError:
        raise
    except httpx2.TimeoutException:
        raise ProviderError(Message.of("provider_timed_out", url=url)) from None
    except (httpx2.HTTPError, httpx2.InvalidURL, OSError) as error:
        reason = network_cause(error)
        raise ProviderError(Message.of("provider_not_reached", url=url, reason=reason)) from None
    except (msgspec.MsgspecError, ValueError, TypeError, OverflowError, RecursionError):
        raise ProviderError(Message.of("provider_response_malformed", url=url)) from None
