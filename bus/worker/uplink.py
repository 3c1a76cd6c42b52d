"""The WebSocket to the app, reconnected whenever it ends, and its TLS.

``bus.contract`` has the order of messages. A worker connects only to the addresses that it was started with,
so that its token goes only where the person who started it sent it.
"""

from __future__ import annotations

import asyncio
import random
import ssl
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, cast
from urllib.parse import urlsplit, urlunsplit

import msgspec
import structlog
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosedOK, InvalidStatus, WebSocketException
from websockets.http11 import Response

from bus.contract import (
    BUFFER_AGE_S,
    CONTRACT_VERSION,
    AppMessage,
    Cancel,
    ClockSync,
    Command,
    Delivered,
    Hello,
    MalformedMessageError,
    ReserveTurn,
    Snapshot,
    WantSnapshot,
    Watch,
    Welcome,
    decode_from_app,
    encode,
)
from bus.contract.session import ClockOffset
from bus.errors import LinesideError
from bus.instants import Clock, Monotonic
from bus.pacing import Bucket, ReconnectDelay
from bus.tls import HTTP_ALPN, WORKER_ALPN, FileStamp, load_authority, load_pair, stamp_of
from bus.worker.outbox import Outbox


def feed_url(url: str) -> str:
    """Return ``http(s)://host:port`` or ``ws(s)://host:port/feed`` as the address of the feed."""
    parts = urlsplit(url)
    scheme = {"http": "ws", "https": "wss"}.get(parts.scheme, parts.scheme)
    path = parts.path.rstrip("/")
    return urlunsplit((scheme, parts.netloc, path if path.endswith("/feed") else f"{path}/feed", "", ""))


def is_encrypted(url: str) -> bool:
    """Return whether the feed at ``url`` uses TLS."""
    return feed_url(url).startswith("wss:")


class AppAddresses:
    """The addresses of the app and its spare, of which one is in use. ``apps``: at least one address."""

    def __init__(self, apps: Sequence[str]) -> None:
        self._feeds = tuple(dict.fromkeys(map(feed_url, apps)))
        self._at = 0

    @property
    def feed(self) -> str:
        """The address to connect to."""
        return self._feeds[self._at]

    @property
    def are_several(self) -> bool:
        return len(self._feeds) > 1

    def leave(self) -> None:
        """Go on to the next address, because this one does not accept the worker."""
        self._at = (self._at + 1) % len(self._feeds)


_OF_DASHBOARD = {
    9: "the dashboard's certificate is not valid yet: compare the clocks of both machines",
    10: "the dashboard's certificate has expired: renew it there with 'lineside certificate create'",
    62: "the dashboard's certificate is not for this name: use one of its names in --app, or create it "
    "again with --name",
    64: "the dashboard's certificate is not for this address: use one of its names in --app, or create it "
    "again with --name",
}
"""The text for each error of OpenSSL's verification (X509_V_ERR_…)."""
_UNKNOWN_AUTHORITY = frozenset({2, 18, 19, 20, 21})
_ALERTS = {
    "CERTIFICATE_EXPIRED": "it has expired: renew it with 'lineside certificate create'",
    "UNKNOWN_CA": "the authority in client_ca of the dashboard has not signed it",
    "CERTIFICATE_REQUIRED": "none was shown: give --certificate and --key",
}
"""The objection of the dashboard to the worker's certificate, by the end of an alert's name."""
_NO_TLS = frozenset({"WRONG_VERSION_NUMBER", "HTTP_REQUEST", "RECORD_LAYER_FAILURE"})


class _LinkConnection(ClientConnection):
    """A connection that keeps why it was lost: the library reports a TLS alert during its opening handshake
    as a mere end."""

    lost_by: Exception | None = None

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost_by = exc
        super().connection_lost(exc)


@dataclass(slots=True)
class UplinkTls:
    """The TLS of the uplink. ``ca``: the authority of the dashboard; None for those that this machine trusts.
    ``pair``: the worker's certificate and key. All are read again when they have changed."""

    ca: Path | None = None
    pair: tuple[Path, Path] | None = None
    _context: ssl.SSLContext | None = field(default=None, init=False)
    _stamps: tuple[FileStamp, ...] = field(default=(), init=False)
    _connection: _LinkConnection | None = field(default=None, init=False)

    def context(self) -> ssl.SSLContext:
        """Return the context of the next connection, which verifies the dashboard and its name. Raise
        TlsFileError for a file that cannot be used."""
        stamps = tuple(map(stamp_of, (*((self.ca,) if self.ca else ()), *(self.pair or ()))))
        if self._context is None or stamps != self._stamps:
            self._context, self._stamps = self._made(), stamps
        return self._context

    def _made(self) -> ssl.SSLContext:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_alpn_protocols([WORKER_ALPN, HTTP_ALPN])
        if self.ca is None:
            context.load_default_certs()
        else:
            load_authority(context, self.ca)
        if self.pair is not None:
            load_pair(context, *self.pair)
        return context

    def connection(self, *args: Any, **options: Any) -> ClientConnection:
        """Make the next connection, whose fault can then be found."""
        self._connection = _LinkConnection(*args, **options)
        return self._connection

    def fault(self, error: BaseException) -> str:
        """Return the fault of a TLS handshake and at which end it is; empty if TLS is not at fault."""
        lost_by = self._connection.lost_by if self._connection else None
        errors = (*_causes(error), *_causes(lost_by))
        found = next((each for each in errors if isinstance(each, ssl.SSLError)), None)
        match found:
            case None:
                return ""
            case ssl.SSLCertVerificationError():
                return _of_dashboard(found)
        reason = getattr(found, "reason", None) or str(found)
        if reason in _NO_TLS:
            return "no TLS is spoken there: is --app to begin with http://?"
        if "ALERT" in reason:
            return f"the dashboard refused the certificate of this worker: {_of_alert(reason)}"
        return f"TLS failed: {_in_words(reason)}"


def _of_dashboard(error: ssl.SSLCertVerificationError) -> str:
    if error.verify_code in _UNKNOWN_AUTHORITY:
        return "the dashboard's certificate is of an unknown authority: give the ca.pem of its site as --ca"
    text = f"the dashboard's certificate cannot be verified: {error.verify_message}"
    return _OF_DASHBOARD.get(error.verify_code, text)


def _of_alert(reason: str) -> str:
    return next((text for name, text in _ALERTS.items() if reason.endswith(name)), _in_words(reason))


def _in_words(reason: str) -> str:
    return reason.lower().replace("_", " ")


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


MIN_PAUSE_S = 0.1
MAX_PAUSE_S = 2.0
HURRY_S = 5.0
"""The seconds of short pauses after the start or a lost link, when the app is probably starting."""
REFUSED_PAUSE_S = 5.0
NEXT_PAUSE_S = 1.0
"""The pause after a refusal if there is another address, in seconds."""
STALLED_S = 4.0
"""The seconds of silence after which the worker goes to the next app; an app sends each second."""
MESSAGES_PER_S, MAX_MESSAGES_AT_ONCE = 500.0, 2_000.0
"""The rate of messages accepted from the app; more wait in the socket, and polling continues."""
OPEN_TIMEOUT_S = 5.0
WELCOME_WITHIN_S = 10.0
PING_S = 5.0
MAX_BYTES = 4_000_000
MAX_DETAIL_BYTES = 4_000
MAX_DETAIL = 300
GOING_AWAY = 1001
"""The close code of a worker that leaves: its bus is free at once. After any other end it may come back."""

_log = structlog.get_logger("bus.uplink")


class AppRequests(Protocol):
    """The receiver of the app's requests to this worker; every call returns at once."""

    def hello(self) -> Hello:
        """Return the first message, which names this worker."""

    def note_held(self, units: Sequence[int]) -> None:
        """Take, at each link, the units that may hold a staged speed of an earlier worker."""

    def snapshot(self, seq: int) -> Snapshot:
        """Return the complete state that is known now."""

    def command(self, command: Command) -> None:
        """Carry out a command of the app."""

    def reserve(self) -> None:
        """Keep the next turn of the wire free, because a write is about to be requested."""

    def cancel(self, command_id: str) -> None:
        """Cancel a command at its next point where nothing is half done."""

    def watch(self, watch: Watch) -> None:
        """Take the units that people have on an open page."""


class _Problem(msgspec.Struct):
    detail: str


class RefusedByAppError(Exception):
    """Raised when the app refuses this worker; the text is the app's."""


class Uplink:
    """The link to the app: ``run`` it until cancelled. ``apps``: the addresses of the server and of its
    spare; ``tls``: for those that begin with https."""

    def __init__(
        self,
        apps: Sequence[str],
        token: str,
        outbox: Outbox,
        handler: AppRequests,
        app_clock: ClockOffset,
        epoch: Clock,
        tls: UplinkTls | None = None,
    ) -> None:
        self._tls = tls
        self._addresses = AppAddresses(apps)
        self._headers = {"Authorization": f"Bearer {token}"}
        self._outbox = outbox
        self._handler = handler
        self._app_clock = app_clock
        self._epoch = epoch
        self._snapshot_wanted = False
        self._logged = ""
        self._backoff = ReconnectDelay(random.random)
        self._accepted_at: float | None = None
        """The time when the app accepted the connection; None if it has not."""
        self._is_stalled = False
        """Whether the app sent nothing for too long, so that another may have taken its place."""

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        pause, linked_at = MIN_PAUSE_S, loop.time()
        while True:
            self._accepted_at, self._is_stalled = None, False
            refused = await self._attempt()
            if refused or self._accepted_at is None or self._is_stalled:
                self._addresses.leave()
            self._outbox.disconnected()
            self._handler.watch(Watch(units=[]))
            if refused:
                pause = NEXT_PAUSE_S if self._addresses.are_several else REFUSED_PAUSE_S
            elif self._accepted_at is not None:
                pause = self._backoff.ended(loop.time() - self._accepted_at) or MIN_PAUSE_S
                linked_at = loop.time()
            elif loop.time() - linked_at > HURRY_S:
                pause = min(pause * 1.6, MAX_PAUSE_S)
            await asyncio.sleep(pause * random.uniform(0.75, 1.25))

    async def _attempt(self) -> bool:
        """Connect once and stay until the connection ends; return whether the app refused this worker."""
        try:
            await self._connect_once()
        except RefusedByAppError as error:
            self._log_unreachable(f"the dashboard refused this worker: {error}")
            return True
        except InvalidStatus as error:
            self._log_unreachable(f"{self._addresses.feed}: {_about_status(error.response)}")
            return error.response.status_code in (401, 403)
        except LinesideError as error:
            self._log_unreachable(f"no link to {self._addresses.feed}: {error}")
        except (OSError, TimeoutError, UnicodeError, WebSocketException, MalformedMessageError) as error:
            tls = self._tls_of_address
            fault = "" if tls is None else tls.fault(error)
            why = fault or str(error) or type(error).__name__
            self._log_unreachable(f"no dashboard at {self._addresses.feed}: {why}")
        return False

    @property
    def _tls_of_address(self) -> UplinkTls | None:
        return self._tls if is_encrypted(self._addresses.feed) else None

    async def _connect_once(self) -> None:
        tls = self._tls_of_address
        async with connect(
            self._addresses.feed,
            ssl=None if tls is None else tls.context(),
            create_connection=None if tls is None else cast(Any, tls.connection),
            additional_headers=self._headers,
            compression=None,
            open_timeout=OPEN_TIMEOUT_S,
            ping_interval=PING_S,
            ping_timeout=PING_S,
            close_timeout=0.5,
            max_size=MAX_BYTES,
            proxy=None,
        ) as socket:
            self._accepted_at = asyncio.get_running_loop().time()
            welcome = await self._handshake(socket)
            self._outbox.resume(welcome.seq, oldest=self._epoch() - BUFFER_AGE_S)
            await socket.send(encode(self._handler.snapshot(self._outbox.seq)))
            self._linked()
            sending = asyncio.create_task(self._send(socket))
            try:
                await self._receive(socket)
            except asyncio.CancelledError:
                await socket.close(GOING_AWAY, "the worker leaves")
                raise
            finally:
                sending.cancel()
                await asyncio.gather(sending, return_exceptions=True)

    def _linked(self) -> None:
        if self._backoff.is_worth_logging:
            self._logged = ""
            _log.info("linked to the dashboard", url=self._addresses.feed, kept=len(self._outbox))

    async def _handshake(self, socket: ClientConnection) -> Welcome:
        await socket.send(encode(self._handler.hello()))
        async with asyncio.timeout(WELCOME_WITHIN_S):
            welcome = _decoded(await socket.recv())
        if not isinstance(welcome, Welcome):
            raise RefusedByAppError("no welcome was received; is this a Lineside dashboard?")
        if welcome.refused:
            raise RefusedByAppError(welcome.refused)
        if welcome.version != CONTRACT_VERSION:
            raise RefusedByAppError(
                f"it uses version {welcome.version} of the link and this worker {CONTRACT_VERSION}: "
                "install the same release of lineside on both"
            )
        self._app_clock.observe(welcome.app_time, self._epoch())
        self._handler.note_held(welcome.held)
        return welcome

    async def _receive(self, socket: ClientConnection) -> None:
        loop, bucket, is_new = asyncio.get_running_loop(), Bucket(MESSAGES_PER_S, MAX_MESSAGES_AT_ONCE), True
        async for data in self._messages(socket):
            try:
                self._take(_decoded(data))
            except MalformedMessageError as error:
                if is_new:
                    _log.warning(
                        "the dashboard sent a malformed message; ignored", error=str(error)[:MAX_DETAIL]
                    )
                is_new = False
            await asyncio.sleep(bucket.pour(1.0, Monotonic(loop.time())))

    async def _messages(self, socket: ClientConnection) -> AsyncIterator[str | bytes]:
        """Yield what the app sends until the connection ends. If there are several apps, silence ends it
        too."""
        with suppress(ConnectionClosedOK):
            while True:
                async with asyncio.timeout(STALLED_S if self._addresses.are_several else None) as patience:
                    try:
                        data = await socket.recv()
                    finally:
                        self._is_stalled = patience.expired()
                yield data

    def _take(self, message: AppMessage) -> None:
        match message:
            case Delivered(seq=seq):
                self._outbox.delivered(seq)
            case ClockSync(app_time=app_time):
                self._app_clock.observe(app_time, self._epoch())
            case Command():
                self._handler.command(message)
            case ReserveTurn():
                self._handler.reserve()
            case Cancel(id=command_id):
                self._handler.cancel(command_id)
            case Watch():
                self._handler.watch(message)
            case WantSnapshot():
                self._snapshot_wanted = True
                self._outbox.filled.set()

    async def _send(self, socket: ClientConnection) -> None:
        """Send each update at once; updates that pile up while the socket is slow go together."""
        while True:
            if self._snapshot_wanted:
                self._snapshot_wanted = False
                await socket.send(encode(self._handler.snapshot(self._outbox.seq)))
            elif (batch := self._outbox.next_batch(self._epoch(), self._app_clock.seconds)) is not None:
                await socket.send(encode(batch))
            else:
                await self._outbox.filled.wait()

    def _log_unreachable(self, what: str) -> None:
        if what != self._logged:
            _log.warning("dashboard unreachable; retrying, buffering readings", why=what)
        self._logged = what


def _decoded(data: str | bytes) -> AppMessage:
    return decode_from_app(data.encode() if isinstance(data, str) else data)


def _about_status(response: Response) -> str:
    status = response.status_code
    if status in (401, 403):
        why = _problem_detail(bytes(response.body or b"")) or "create one with 'lineside token create'"
        return f"the dashboard does not accept the token ({status}): {why}"
    why = _problem_detail(bytes(response.body or b"")) or "is the address right?"
    return f"the dashboard responds {status} instead of opening the feed: {why}"


def _problem_detail(body: bytes) -> str:
    """Return the detail of an ``application/problem+json`` as one line of bounded length for the log."""
    try:
        detail = msgspec.json.decode(body[:MAX_DETAIL_BYTES], type=_Problem).detail
    except (msgspec.DecodeError, ValueError):
        return ""
    return "".join(sign for sign in detail[:MAX_DETAIL] if sign.isprintable())
