"""Reads the lines of the peers: one connection to each, bounded in bytes and time."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Mapping
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import structlog

from app.core.server.settings import SecretFileError, read_secret_text
from app.errors import is_refused_certificate, network_cause, system_error
from app.system.peers.board import LineBoard, Peer
from app.system.peers.report import ReportError, read_report
from app.system.peers.settings import PeerSettings
from app.system.peers.summary import LineSummary
from app.version import VERSION
from bus.errors import LinesideError
from bus.messages import Message

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    import httpx

PATH = "/api/v1/sites"
EVERY_S = 2.0
REFUSED_EVERY_S = 10.0
"""Where a person has to change something first."""
WITHIN_S = 5.0
MAX_BYTES = 1024 * 1024
"""255 lines are half of it."""
_log = structlog.get_logger()


class PeerError(LinesideError):
    """Why a peer is not read, without what it wrote."""


class PeerAwayError(PeerError):
    """There is no connection to it now."""


async def follow(peer: Peer, board: LineBoard) -> None:
    """Run until canceled: read a peer. The files of its token and its authority are read again after a
    refusal."""
    while True:
        try:
            async with _client(peer.settings) as client:
                while True:
                    await _read_onto(board, peer, client)
                    await asyncio.sleep(EVERY_S)
        except PeerError as error:
            _note(peer, error.message)
        await asyncio.sleep(REFUSED_EVERY_S)


async def _read_onto(board: LineBoard, peer: Peer, client: httpx.AsyncClient) -> None:
    """Read one report. A peer that is away is noted. Raises PeerError for one that refuses."""
    try:
        report = await _read(client, peer.settings)
    except PeerAwayError as error:
        _note(peer, error.message)
        return
    before = peer.fault
    if fault := board.put(peer, *report):
        raise PeerError(fault)
    if before is not None:
        _log.info("peer read again", peer=peer.settings.name)


def _note(peer: Peer, fault: Message) -> None:
    if fault != peer.fault:
        _log.warning("peer not read", peer=peer.settings.name, why=str(fault))
    peer.fault = fault


async def fault_of(settings: PeerSettings) -> Message | None:
    """Read a peer once; return why it cannot be read."""
    try:
        async with _client(settings) as client:
            await _read(client, settings)
    except PeerError as error:
        return error.message
    return None


@asynccontextmanager
async def _client(settings: PeerSettings) -> AsyncIterator[httpx.AsyncClient]:
    """Return a client with the token of the peer. Raises PeerError."""
    import httpx  # a tenth of a second of the start

    ca_file = None if settings.ca_file is None else str(settings.ca_file)
    try:
        token = read_secret_text(settings.token_file)
        context = ssl.create_default_context(cafile=ca_file)
    except SecretFileError as error:
        raise PeerError(error.message) from None
    except OSError as error:
        raise PeerError(
            Message.of("peer_authority_unreadable", path=ca_file or "", reason=system_error(error))
        ) from None
    headers = {"Authorization": f"Bearer {token}", "Accept-Encoding": "identity", "User-Agent": "lineside"}
    limits = httpx.Limits(max_connections=1)
    # No proxy and no password of the environment: they lead out of the plant.
    async with httpx.AsyncClient(
        verify=context, trust_env=False, timeout=WITHIN_S, limits=limits, headers=headers
    ) as client:
        yield client


async def _read(
    client: httpx.AsyncClient, settings: PeerSettings
) -> tuple[Mapping[str, LineSummary], str, str]:
    """Return the lines of a peer, its instance and its time. Raises PeerError."""
    import httpx

    request = client.build_request("GET", f"{settings.url}{PATH}", params={"own": "true"})
    try:
        async with asyncio.timeout(WITHIN_S):
            content = await _exchange(client, request, settings)
    except (httpx.TimeoutException, TimeoutError):
        raise PeerAwayError(Message.of("peer_timed_out", n=round(WITHIN_S))) from None
    except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
        kind = PeerError if is_refused_certificate(error) else PeerAwayError
        raise kind(Message.of("peer_not_reached", reason=network_cause(error))) from None
    try:
        return read_report(content)
    except ReportError as error:
        if error.version:
            fault = Message.of("peer_of_other_version", theirs=error.version, ours=VERSION)
        else:
            fault = Message("peer_sends_other")
        raise PeerError(fault) from None


async def _exchange(client: httpx.AsyncClient, request: httpx.Request, settings: PeerSettings) -> bytes:
    """Return the body, as it came: what is packed could be of any size once it is unpacked."""
    response = await client.send(request, stream=True, follow_redirects=False)
    try:
        if response.status_code != 200:
            raise _refusal(response.status_code, settings)
        content = bytearray()
        async for piece in response.aiter_raw():
            content += piece
            if len(content) > MAX_BYTES:
                raise PeerError(Message.of("peer_too_large", most=MAX_BYTES))
    finally:
        await response.aclose()
    return bytes(content)


def _refusal(status: int, settings: PeerSettings) -> PeerError:
    match status:
        case 401:
            return PeerError(Message.of("peer_token_refused", path=str(settings.token_file)))
        case 403:
            return PeerError(Message.of("peer_token_role", path=str(settings.token_file)))
        case 404 | 422:
            return PeerError(Message.of("peer_of_earlier_version", status=status))
        case 429 | 502 | 503 | 504:
            return PeerAwayError(Message.of("peer_busy", status=status))
        case _ if 300 <= status < 400:
            return PeerError(Message.of("peer_redirects", status=status))
        case _:
            return PeerError(Message.of("peer_status", status=status))
