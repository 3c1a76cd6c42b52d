"""The connection of an edge node to the plant's broker: births, changes, missed readings, reconnection.

Nothing of the server waits for it. Data have quality of service 0, as Sparkplug requires, so the broker
confirms none of them. After messages that are sent together comes an empty message that it does confirm, and
with it everything before it on the same connection: after a loss, the readings since the last confirmed one
are sent from the history, marked as historical. Only messages under way at that moment may come twice.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from functools import partial
from hashlib import blake2b
from typing import TYPE_CHECKING, Any

import msgspec
import structlog

from app.core.database import Database
from app.core.lifespan import cancel
from app.core.server.settings import SecretFileError, read_secret_text
from app.errors import StoreError, is_refused_certificate, network_cause
from app.line.history.series.runs import DAY, SECOND, micros
from app.line.history.service import History
from app.line.live.bus_live import Audience, Silence
from app.system.mqtt.backlog import Backlog, PastReadings, read_backlog, write_backlog
from app.system.mqtt.node import NAMESPACE, EdgeNode, Publication
from app.system.mqtt.settings import MqttSettings
from bus.contract import Update
from bus.errors import LinesideError
from bus.instants import UnixTime, monotonic_now, unix_now
from bus.messages import Message, in_english, number
from bus.tls import TlsFileError, load_authority, load_pair

if TYPE_CHECKING:
    import aiomqtt

    from app.system.mqtt.overview import BrokerLines

KEEP_ALIVE_S = 10
CONNECT_S = 10.0
RETRY_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""The seconds between two attempts; the last value repeats."""
STEADY_S = 30.0
"""The duration after which a connection counts as good."""
FLUSH_S = 0.2
"""The span of changes that are sent together, about one scan of a line: each sending wakes the server and the
broker, on a machine that the bus worker may share with both."""
MESSAGES_S = 400
"""The approximate most messages a second, as each takes the server a tenth of a millisecond: on a line with
more values, a message has several readings of its unit, each with its time."""
TICK_S = 0.5
"""The seconds between checks of ages if nothing changes."""
STORE_EVERY_S = 10.0
SETTLED_S = 1.0
"""The time in which the readings of a moment reach the history."""
MAX_COMMAND = 64 * 1024
QUALITY_OF_SERVICE = 1
log = structlog.get_logger()


class BrokerError(LinesideError):
    """Raised if the connection to the broker fails or ends; the message has the reason."""


def require_package() -> None:
    """Raise BrokerError if aiomqtt is not installed."""
    try:
        import aiomqtt  # noqa: F401
    except ImportError:
        raise BrokerError(Message("mqtt_no_package")) from None


@asynccontextmanager
async def connected(
    settings: MqttSettings, identifier: str, will: Publication | None = None
) -> AsyncIterator[aiomqtt.Client]:
    """Connect to the broker for the duration of the context. Raise BrokerError, also if the connection ends
    in the context."""
    require_package()
    import aiomqtt

    last = None if will is None else aiomqtt.Will(will.topic, will.payload, QUALITY_OF_SERVICE)
    place, was_connected = settings.place, False
    library_log, errors = logging.Logger("mqtt", logging.ERROR), _SocketErrors()
    library_log.addHandler(errors)
    try:
        password = read_secret_text(settings.password_file) if settings.password_file else None
        async with aiomqtt.Client(
            settings.host,
            settings.port,
            identifier=identifier,
            username=settings.username or None,
            password=password,
            will=last,
            clean_session=True,
            protocol=aiomqtt.ProtocolVersion.V311,
            keepalive=KEEP_ALIVE_S,
            timeout=CONNECT_S,
            tls_context=_tls(settings),
            logger=library_log,
            max_queued_incoming_messages=1000,
            socket_options=((socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),),
        ) as client:
            was_connected = True
            yield client
    except SecretFileError as error:
        raise BrokerError(error.message) from None
    except aiomqtt.MqttError as error:
        if was_connected:
            raise BrokerError(Message.of("mqtt_dropped", place=place)) from None
        if isinstance(error, aiomqtt.MqttCodeError):
            raise BrokerError(Message.of("mqtt_refused", place=place, reason=str(error.rc))) from None
        raise BrokerError(_why_not_reached(place, errors.last, error.__context__ or error)) from None


def _tls(settings: MqttSettings) -> ssl.SSLContext | None:
    """Return the TLS context: the authority that the broker is trusted by, and the certificate of this
    server. Raise BrokerError."""
    if not settings.uses_tls:
        return None
    context = ssl.create_default_context()
    try:
        if settings.ca_file is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            load_authority(context, settings.ca_file)
        if settings.certificate is not None and settings.key is not None:
            load_pair(context, settings.certificate, settings.key)
    except TlsFileError as error:
        raise BrokerError(error.message) from None
    return context


class _SocketErrors(logging.Handler):
    """The handler that keeps the last socket error. The library only logs an error that comes before the
    broker's response, as when TLS 1.3 refuses a client certificate, and reports a timeout."""

    last: OSError | None = None

    def emit(self, record: logging.LogRecord) -> None:
        arguments = record.args if isinstance(record.args, tuple) else ()
        self.last = next((each for each in arguments if isinstance(each, OSError)), self.last)


def _why_not_reached(place: str, lost_by: OSError | None, cause: BaseException) -> Message:
    """Return why there is no connection. ``lost_by``: the error before the broker responded."""
    if is_refused_certificate(cause):
        return Message.of("mqtt_not_trusted", place=place, reason=network_cause(cause))
    if isinstance(lost_by, ssl.SSLError) and "_ALERT_" in (lost_by.reason or ""):
        alert = lost_by.reason.rpartition("_ALERT_")[2].replace("_", " ").lower()
        return Message.of("mqtt_certificate_refused", place=place, reason=alert)
    if lost_by is not None or (isinstance(cause, TimeoutError) and not cause.args):
        return Message.of("mqtt_silent", place=place)
    reason = getattr(cause, "strerror", None) or str(cause)
    return Message.of("mqtt_not_reached", place=place, reason=reason)


def identifier_for(*parts: str) -> str:
    """Return a connection's client id: 23 characters, as every broker takes (MQTT 3.1.1, 3.1.3)."""
    return "lineside" + blake2b("\0".join(parts).encode(), digest_size=7).hexdigest()


@dataclass(slots=True)
class NodeStatus:
    """The state of a node's connection. ``fault``: why it is not connected; ``waits``: whether it waits for
    its primary host; ``host_is_behind``: whether that host's newest message is older than the one before, by
    its own clock; ``sent``: messages since the start."""

    is_connected: bool = False
    fault: Message | None = None
    waits: bool = False
    host_is_behind: bool = False
    sent: int = 0


class Nodes(tuple["NodeSession", ...]):
    """The sessions of all nodes; empty if no broker is configured. ``overview``: the reader of other servers'
    lines, if wanted."""

    overview: BrokerLines | None = None

    @property
    def fault(self) -> Message | None:
        """Why the first of the connections without the broker has none; None if every one has it."""
        faults = [node.status.fault for node in self]
        if self.overview is not None:
            faults.append(self.overview.fault)
        return next(filter(None, faults), None)


class NodeSession:
    """The connection of one edge node to the broker, renewed after each loss. ``summary``: makes the document
    of the line."""

    def __init__(
        self,
        settings: MqttSettings,
        node: EdgeNode,
        database: Database,
        history: History,
        summary: Callable[[], bytes],
        raw_days: int,
    ) -> None:
        self.node = node
        self.status = NodeStatus()
        self._settings, self._database, self._history = settings, database, history
        self._summary, self._raw_days = summary, raw_days
        self._past = PastReadings(node.bus.settings)
        self.backlog: Backlog | None = None
        self._wake = asyncio.Event()
        self._sending = asyncio.Lock()
        self._silence: Silence | None = None
        self._host_is_online: bool | None = None
        self._host_time = 0
        node.bus.subscribe(Audience.STREAM, self._note)

    # --- reports of the line ---

    def _note(self, updates: Sequence[Update]) -> None:
        self.node.note(updates)
        self._wake.set()

    def note_unit(self, unit: int) -> None:
        """Note that an alarm of a unit changed, and wake the session."""
        self.node.note_unit(unit)
        self._wake.set()

    # --- connections, one after the other ---

    async def follow(self) -> None:
        """Publish until canceled; connect again after each loss, with growing delays."""
        failures = 0
        while True:
            began = monotonic_now()
            try:
                await self._connection()
            except StoreError as error:
                self._fail(error.message)
            except BrokerError as error:
                self._fail(error.message)
            failures = 0 if monotonic_now() - began > STEADY_S else failures + 1
            await asyncio.sleep(RETRY_S[min(failures, len(RETRY_S)) - 1] if failures else 0)

    def _fail(self, message: Message) -> None:
        if message != self.status.fault:
            log.warning("broker lost", node=self.node.name, why=in_english(message))
        self.status.fault, self.status.is_connected = message, False

    async def end(self) -> None:
        """Store the unsent spans as the server ends."""
        if self.backlog is not None:
            await self._store(self.backlog)

    async def _connection(self) -> None:
        """Publish over one connection. Raise BrokerError or StoreError."""
        backlog = self.backlog
        if backlog is None:
            bus = self.node.bus.settings
            backlog = await self._database.read(lambda connection: read_backlog(connection, bus))
            self.backlog = backlog
        bd_seq = backlog.connect()
        await self._store(backlog)
        self._host_is_online = None
        will = self.node.death(bd_seq, unix_now())
        identifier = identifier_for(self.node.group, self.node.name)
        try:
            async with connected(self._settings, identifier, will) as client:
                await self._subscribe(client)
                try:
                    await _first_of(self._receive(client), self._publish(client, backlog, bd_seq))
                finally:
                    await self._say_goodbye(client, bd_seq)
        finally:
            self.node.end()
            self.status.is_connected = False

    async def _subscribe(self, client: aiomqtt.Client) -> None:
        for topic in self.node.subscriptions:
            await client.subscribe(topic, QUALITY_OF_SERVICE)
        if self._settings.primary_host:
            await client.subscribe(self._state_topic, QUALITY_OF_SERVICE)

    @property
    def _state_topic(self) -> str:
        return f"{NAMESPACE}/STATE/{self._settings.primary_host}"

    async def _say_goodbye(self, client: aiomqtt.Client, bd_seq: int) -> None:
        """Publish the death of the node: a connection that is ended on purpose leaves no will (Sparkplug 3.0,
        6.4.22)."""
        import aiomqtt

        with suppress(aiomqtt.MqttError, TimeoutError):
            async with asyncio.timeout(1):
                death = self.node.death(bd_seq, unix_now())
                await client.publish(death.topic, death.payload, QUALITY_OF_SERVICE)

    # --- messages of others ---

    async def _receive(self, client: aiomqtt.Client) -> None:
        async for message in client.messages:
            topic = str(message.topic)
            payload = message.payload if isinstance(message.payload, bytes) else b""
            if topic == self._state_topic:
                self._take_state(payload)
                continue
            refused = self.node.refused
            command = partial(self.node.take_command, topic, payload[:MAX_COMMAND], unix_now())
            await self._send(client, command)
            if self.node.refused == 1 > refused:
                log.warning("command by MQTT refused: nothing is commanded that way", topic=topic[:200])

    def _take_state(self, payload: bytes) -> None:
        """Take over the primary host's state unless it is older (Sparkplug 3.0, 6.4.27)."""
        try:
            state = msgspec.json.decode(payload[:MAX_COMMAND], type=_HostState)
        except (msgspec.MsgspecError, ValueError):
            return
        self.status.host_is_behind = state.timestamp < self._host_time
        if not self.status.host_is_behind:
            self._host_time, self._host_is_online = state.timestamp, state.online
            self._wake.set()

    # --- own messages ---

    async def _publish(self, client: aiomqtt.Client, backlog: Backlog, bd_seq: int) -> None:
        await self._await_host()
        if self.status.fault is not None:
            log.info("broker reached again", node=self.node.name)
        self.status.fault, self.status.is_connected = None, True
        await self._send(client, lambda: self.node.begin(bd_seq, unix_now()))
        self._add_missed(backlog)
        await _first_of(self._send_changes(client, backlog), self._catch_up(client, backlog))

    async def _await_host(self) -> None:
        """Wait until the primary host, if one is configured, is online."""
        self.status.waits = bool(self._settings.primary_host)
        while self.status.waits and not self._host_is_online:
            self._wake.clear()
            await self._wake.wait()
        self.status.waits = False

    def _add_missed(self, backlog: Backlog) -> None:
        """Add the time without a connection to the backlog, for each unit up to its birth's reading."""
        now = micros(unix_now())
        ends = {
            number: micros(device.sent_until) if device.sent is not None else now
            for number, device in self.node.devices.items()
        }
        if backlog.received:
            # The reading of that moment was received.
            backlog.add(backlog.received + 1, ends, now - self._raw_days * DAY)
        self._silence = self.node.bus.silence

    async def _send_changes(self, client: aiomqtt.Client, backlog: Backlog) -> None:
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(TICK_S):
                    await self._wake.wait()
            self._wake.clear()
            if self._host_is_online is False:
                raise BrokerError(Message.of("mqtt_host_away", host=self._settings.primary_host))
            if self.node.is_behind:
                raise BrokerError(Message.of("mqtt_too_slow", place=self._settings.place))
            self._note_silence(backlog)
            before = self.status.sent
            await self._send(client, lambda: self.node.changes(unix_now()))
            if self.status.sent > before:
                await self._confirm(client, backlog)
            await asyncio.sleep(max(FLUSH_S, (self.status.sent - before) / MESSAGES_S))

    def _note_silence(self, backlog: Backlog) -> None:
        """Add a silence of the worker to the backlog: only the history gets its readings of that time."""
        silence = self.node.bus.silence
        if silence is not None and silence != self._silence:
            self._silence = silence
            ends = dict.fromkeys(self.node.devices, micros(silence.until))
            now = micros(unix_now())
            backlog.add(micros(silence.since) + 1, ends, now - self._raw_days * DAY)

    async def _send(self, client: aiomqtt.Client, made: Callable[[], Iterable[Publication]]) -> None:
        """Make messages and send them. No others are made meanwhile: sequence numbers must follow the order
        of sending."""
        async with self._sending:
            for topic, payload in made():
                await client.publish(topic, payload, qos=0)
                self.status.sent += 1

    async def _catch_up(self, client: aiomqtt.Client, backlog: Backlog) -> None:
        """Publish the summary of the line once a second, and send missed readings piece by piece."""
        store_at = monotonic_now() + STORE_EVERY_S
        while True:
            await asyncio.sleep(SETTLED_S)
            await client.publish(self.node.document_topic, self._summary(), retain=True)
            await self._confirm(client, backlog)
            while (piece := backlog.next_piece(self._born())) is not None:
                await self._send_piece(client, backlog, *piece)
            if monotonic_now() >= store_at:
                store_at = monotonic_now() + STORE_EVERY_S
                await self._store(backlog)

    def _born(self) -> set[int]:
        return {number for number in self.node.devices if self.node.is_born(number)}

    async def _send_piece(
        self, client: aiomqtt.Client, backlog: Backlog, unit: int, span: tuple[int, int]
    ) -> None:
        """Send the readings of a unit over a span as historical; remove the span once they were received."""
        rows = await self._history.read(partial(self._past.read, unit=unit, span=span))
        was_born = False

        def make() -> Iterable[Publication]:
            nonlocal was_born
            was_born = self.node.is_born(unit)
            return self.node.historical(unit, rows, unix_now())

        await self._send(client, make)
        await self._confirm(client, backlog)
        if was_born:
            backlog.sent(unit, span[1])

    async def _confirm(self, client: aiomqtt.Client, backlog: Backlog) -> None:
        """Wait until the broker has received all messages, and note the time of the last reading."""
        sent_until = max((each.sent_until for each in self.node.devices.values()), default=UnixTime(0.0))
        await client.publish(f"{self.node.document_topic}/received", b"", QUALITY_OF_SERVICE)
        backlog.received = max(backlog.received, micros(sent_until))

    async def _store(self, backlog: Backlog) -> None:
        await self._database.write(lambda connection: write_backlog(connection, backlog))

    @property
    def has_delivered(self) -> bool:
        """Whether the broker has ever received a reading."""
        return self.backlog is not None and self.backlog.received > 0

    def lag_s(self) -> float:
        """Return the seconds of readings that the broker has not received; 0 before it received any."""
        if self.backlog is None or not self.has_delivered:
            return 0.0
        waiting = self.backlog.waiting_s()
        if self.status.is_connected:
            return waiting
        return waiting + max(0.0, float(unix_now()) - self.backlog.received / SECOND)

    def state(self) -> Message:
        """Return a sentence about the connection of the node."""
        place, node = self._settings.place, self.node.name
        if self.status.host_is_behind and not self.status.is_connected:
            return Message.of("mqtt_waits_clock", node=node, host=self._settings.primary_host)
        if self.status.fault is not None:
            if not self.has_delivered:
                return Message.of("mqtt_lacks_all", node=node, reason=self.status.fault)
            seconds = number(f"{self.lag_s():.0f}")
            return Message.of("mqtt_lacks", node=node, reason=self.status.fault, seconds=seconds)
        if self.status.waits:
            return Message.of("mqtt_waits", node=node, host=self._settings.primary_host)
        return Message.of("mqtt_has", place=place, node=node, refused=number(str(self.node.refused)))


class _HostState(msgspec.Struct):
    """The state of a host application, as it publishes it (Sparkplug 3.0, 6.4.27)."""

    online: bool
    timestamp: int


async def _first_of(*works: Coroutine[Any, Any, None]) -> None:
    """Run works together until the first ends, end the others, and raise the first's error."""
    tasks = [asyncio.create_task(work) for work in works]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        await cancel(tasks)
    for task in done:
        task.result()
