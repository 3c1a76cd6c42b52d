"""The connections of all bus workers: one for each bus."""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Protocol

import structlog

from app.feed.admission import refusal
from app.feed.channel import Channel, Connection
from app.feed.holders import Credential, Ending, Holder
from app.feed.ingest import Ingest, Received
from app.feed.rates import hello_bucket, update_bucket
from app.live.state.live_state import NO_WORKER
from app.pipeline import Pipeline
from bus.bucket import Bucket
from bus.contract import CONTRACT_VERSION, Hello, MalformedMessageError, Welcome, decode_from_worker
from bus.messages import Message

_log = structlog.get_logger()

SILENT = Message("worker_silent")
MALFORMED = Message("worker_malformed")
REPLACED = "another worker connected for this bus"
TOO_OFTEN = "this bus was connected to too often; wait a minute"
HELLO_WITHIN_S = 10.0
MOST_HELLO_BYTES = 32_768
TICK_S = 1.0
SILENT_TICKS = 5
"""A worker tells its figures every second; one that says nothing for so long is gone or stuck. Ticks are
counted, not seconds, so that a stall of the app itself makes nobody look silent."""


class WorkerLeft(ConnectionError):
    """The worker announced that it leaves."""


class WorkerSilent(ConnectionError):
    """Nothing came from the worker for too long."""


class Socket(Connection, Protocol):
    """A worker's WebSocket as this package sees it."""

    async def receive(self) -> bytes:
        """The next message. Raises ConnectionError when there is none (WorkerLeft where that was announced),
        MalformedMessageError for text."""

    async def close(self, reason: str) -> None:
        """End it, with a reason in words. Raises nothing."""


class Workers:
    """The feed: which worker has each bus, and how far it was followed. ``now`` is Unix time in seconds,
    ``monotonic`` times what is kept for a worker that may come back."""

    def __init__(
        self,
        buses: list[str],
        pipeline: Pipeline,
        now: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
        *,
        silent_ticks: int = SILENT_TICKS,
    ) -> None:
        self.channels = {bus: Channel(bus) for bus in buses}
        self._pipeline = pipeline
        self._now = now
        self._monotonic = monotonic
        self._hello_buckets: defaultdict[str, Bucket] = defaultdict(hello_bucket)
        """By token, so that one cannot use up what another has."""
        self._update_buckets = {bus: update_bucket() for bus in buses}
        self._received: dict[str, Received] = {}
        self._holders: dict[str, Holder] = {}
        self._sockets: dict[str, Socket] = {}
        self._silent_ticks = silent_ticks
        self._wishes: set[asyncio.Task[None]] = set()

    async def serve(self, socket: Socket, credential: Credential) -> None:
        """Serve one connection from its hello to its end. Raises nothing that a worker could cause."""
        try:
            hello = await self._hello(socket, credential)
            await self._admit(hello, socket, credential)
        except (MalformedMessageError, TimeoutError) as error:
            await socket.close(str(error) or "a worker says hello first")
        except ConnectionError:
            return

    def watch(self, bus: str, units: list[int], trace: bool) -> None:
        """Tell a worker which units are on an open page, and whether someone follows its trace."""
        wish = asyncio.create_task(self.channels[bus].watch(units, trace=trace))
        self._wishes.add(wish)
        wish.add_done_callback(self._wishes.discard)

    async def _hello(self, socket: Socket, credential: Credential) -> Hello:
        if self._hello_buckets[credential.token].pour(1.0, self._monotonic()) > 0.0:
            raise MalformedMessageError(TOO_OFTEN)
        async with asyncio.timeout(HELLO_WITHIN_S):
            data = await socket.receive()
        if len(data) > MOST_HELLO_BYTES:
            raise MalformedMessageError("a worker says hello first")
        hello = decode_from_worker(data)
        if not isinstance(hello, Hello):
            raise MalformedMessageError("a worker says hello first")
        return hello

    async def _admit(self, hello: Hello, socket: Socket, credential: Credential) -> None:
        holder = self._holders.get(credential.bus)
        refused = refusal(hello, credential, self.channels, holder, self._monotonic())
        if refused:
            bus, held_by = credential.bus, str(holder.credential) if holder is not None else ""
            self._pipeline.worker_refused(bus, self._now(), held_by, str(credential), refused)
            await socket.send(Welcome(CONTRACT_VERSION, 0, self._now(), refused))
            await socket.close(refused)
            return
        # Taken in the same turn of the loop: of two that say hello together, the second meets the first.
        former = self._take(hello, socket, credential)
        try:
            await self._serve_holder(hello, socket, former)
        finally:
            self._release(hello.bus, socket, NO_WORKER, Ending.LOST)

    def _take(self, hello: Hello, socket: Socket, credential: Credential) -> Socket | None:
        """Give the bus to this worker; the connection that it had until now, if it is still open."""
        bus, received = hello.bus, self._received.get(hello.bus)
        again = received is not None and received.worker == hello.worker
        if not again:
            self._received[bus] = Received(hello.worker)
        self._holders[bus] = Holder(hello.worker, credential)
        former = self._sockets.get(bus)
        self._sockets[bus] = socket
        if former is not None:
            self.channels[bus].closed(former)
        self._pipeline.worker_came(hello, self._now(), again=again)
        return former

    async def _serve_holder(self, hello: Hello, socket: Socket, former: Socket | None) -> None:
        if former is not None:
            await former.close(REPLACED)
        try:
            seq = self._received[hello.bus].seq
            await socket.send(Welcome(CONTRACT_VERSION, seq, self._now()))
            await self._follow(hello, socket)
        except MalformedMessageError as error:
            _log.warning("bus worker sent a malformed message", bus=hello.bus, why=str(error))
            self._release(hello.bus, socket, MALFORMED, Ending.LOST)
            await socket.close(str(error))
        except WorkerSilent:
            self._release(hello.bus, socket, SILENT, Ending.CUT)
            await socket.close(str(SILENT))
        except WorkerLeft:
            self._release(hello.bus, socket, NO_WORKER, Ending.LEFT)

    async def _follow(self, hello: Hello, socket: Socket) -> None:
        channel, received = self.channels[hello.bus], self._received[hello.bus]
        bucket = self._update_buckets[hello.bus]
        ingest = Ingest(hello, received, channel, self._pipeline, socket, bucket, self._now)
        tasks = {asyncio.create_task(work) for work in (self._receive(ingest, socket), self._tick(ingest))}
        try:
            ended, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in ended:
                task.result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _receive(self, ingest: Ingest, socket: Socket) -> None:
        bus = ingest.hello.bus
        while self._sockets.get(bus) is socket:
            await ingest.receive(await socket.receive())
            self._holders[bus].port_seen |= self._pipeline.port_is_open(bus)

    async def _tick(self, ingest: Ingest) -> None:
        while ingest.silent_ticks < self._silent_ticks:
            await ingest.tick()
            await asyncio.sleep(TICK_S)
        raise WorkerSilent(str(SILENT))

    def _release(self, bus: str, socket: Socket, cause: Message, ending: Ending) -> None:
        """This connection has ended. Nothing where it was released already, or another has its place."""
        self.channels[bus].closed(socket)
        if self._sockets.get(bus) is socket:
            del self._sockets[bus]
            self._holders[bus].connection_ended(ending, self._monotonic())
            self._pipeline.worker_went(bus, self._now(), cause)
