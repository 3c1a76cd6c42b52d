"""Reads what a provider responds, in bounds: it may be slow, large or no provider at all."""

from __future__ import annotations

import ssl
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar
from urllib.parse import quote_plus

import msgspec

from app.errors import network_cause, system_error
from bus.errors import LinesideError
from bus.messages import Message

if TYPE_CHECKING:
    import httpx

T = TypeVar("T")

MAX_BYTES = 256 * 1024
"""The keys of Entra ID are 20 KB."""
MAX_CONNECTIONS = 6
SOCKET_S = 5.0


class ProviderError(LinesideError):
    """Why the provider is of no use now, without what it wrote."""


class FormRefusedError(Exception):
    """The provider responds, and refuses a form. The text is its word for the reason (RFC 6749, 5.2)."""


class _FormError(msgspec.Struct):
    error: str = ""


def new_client(ca_file: str | None) -> httpx.AsyncClient:
    """A client that leads nowhere else: no redirects, and no proxy or password of the environment. Raises
    ProviderError where the authority cannot be read."""
    import httpx  # a tenth of a second of the start

    try:
        context = ssl.create_default_context(cafile=ca_file)
    except OSError as error:
        reason = Message.of("provider_authority_unreadable", path=str(ca_file), reason=system_error(error))
        raise ProviderError(reason) from None
    limits = httpx.Limits(max_connections=MAX_CONNECTIONS, max_keepalive_connections=1)
    return httpx.AsyncClient(verify=context, trust_env=False, timeout=SOCKET_S, limits=limits)


async def get(client: httpx.AsyncClient, url: str, kind: type[T]) -> T:
    """What a URL of the provider responds. Raises ProviderError."""
    status, content = await _exchange(client, client.build_request("GET", url, headers=_HEADERS))
    if status != 200:
        raise ProviderError(Message.of("provider_status", url=url, status=status))
    return _decoded(content, url, kind)


async def post(
    client: httpx.AsyncClient,
    url: str,
    form: Mapping[str, str],
    kind: type[T],
    basic: tuple[str, str] | None = None,
) -> T:
    """What a URL of the provider responds to a form. ``basic``: the user and password of HTTP. Raises
    ProviderError, and FormRefusedError."""
    import httpx

    request = client.build_request("POST", url, data=dict(form), headers=_HEADERS)
    if basic is not None:
        # RFC 6749, 2.3.1
        request = next(httpx.BasicAuth(*map(quote_plus, basic)).auth_flow(request))
    status, content = await _exchange(client, request)
    if status != 200:
        with suppress(ProviderError):
            raise FormRefusedError(f"{status} {_printable(_decoded(content, url, _FormError).error)}")
        raise FormRefusedError(str(status))
    return _decoded(content, url, kind)


_HEADERS = {"Accept": "application/json", "Accept-Encoding": "identity", "User-Agent": "lineside"}


async def _exchange(client: httpx.AsyncClient, request: httpx.Request) -> tuple[int, bytes]:
    import httpx

    url = str(request.url)
    try:
        response = await client.send(request, stream=True, follow_redirects=False)
        try:
            content = bytearray()
            # As it came: what is packed could be of any size once it is unpacked.
            async for piece in response.aiter_raw():
                content += piece
                if len(content) > MAX_BYTES:
                    raise ProviderError(Message.of("provider_response_too_large", url=url, most=MAX_BYTES))
        finally:
            await response.aclose()
    except httpx.TimeoutException:
        raise ProviderError(Message.of("provider_timed_out", url=url)) from None
    except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
        raise ProviderError(
            Message.of("provider_not_reached", url=url, reason=network_cause(error))
        ) from None
    return response.status_code, bytes(content)


def _decoded(content: bytes, url: str, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(content, type=kind)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        raise ProviderError(Message.of("provider_response_malformed", url=url)) from None


def _printable(text: str) -> str:
    return "".join(each for each in text[:80] if each.isascii() and each.isprintable())
