"""All workers: one connection for each bus. The newer takes the place of the older, unless the older has
the port open: the child of the server for a port on another machine must not keep sending its worker away."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from app.feed.channel import Channel, Connection
from app.feed.ingest import Heard, Ingest, MalformedSpeechError, decode, welcome
from app.live.state import NO_WORKER
from app.pipeline import Pipeline
from bus.contract import Hello

SILENT = "the bus worker is connected and says nothing"
HELD = "another worker has this bus, and its port is open"
HELLO_WITHIN_S = 10.0
TICK_S = 1.0
SILENT_TICKS = 5
"""A worker tells its figures every second; one that says nothing for so long is gone or stuck. Ticks are
counted, not seconds, so that a stall of the app itself makes nobody look silent."""


class Socket(Connection, Protocol):
    """A worker's WebSocket as this package sees it."""

    async def receive(self) -> bytes:
        """The next message. Raises ConnectionError when there is none, MalformedSpeechError for text."""

    async def close(self, reason: str) -> None:
        """End it, with a reason in words. Raises nothing."""


class Workers:
    """The feed: who is connected, and how far each was followed."""

    def __init__(
        self,
        buses: list[str],
        pipeline: Pipeline,
        now: Callable[[], float] = time.time,
        *,
        silent_ticks: int = SILENT_TICKS,
    ) -> None:
        self.channels = {bus: Channel(bus) for bus in buses}
        self._pipeline = pipeline
        self._now = now
        self._heard: dict[str, Heard] = {}
        self._sockets: dict[str, Socket] = {}
        self._silent_ticks = silent_ticks
        self._wishes: set[asyncio.Task[None]] = set()

    async def serve(self, socket: Socket, bus: str) -> None:
        """Serve one connection, opened with the credentials of ``bus``, from its hello to its end. Raises
        nothing that a worker could cause."""
        try:
            async with asyncio.timeout(HELLO_WITHIN_S):
                hello = decode(await socket.receive())
            if not isinstance(hello, Hello):
                raise MalformedSpeechError("a worker says hello first")
            if not await self._welcomed(hello, socket, bus):
                return
        except (MalformedSpeechError, TimeoutError) as error:
            await socket.close(str(error) or "a worker says hello first")
            return
        except ConnectionError:
            return
        await self._replace(hello.bus, socket)
        await self._follow(hello, socket)

    def watch(self, bus: str, units: list[int], trace: bool) -> None:
        """Tell a worker which units are on an open page, and whether someone follows its trace."""
        wish = asyncio.create_task(self.channels[bus].watch(units, trace=trace))
        self._wishes.add(wish)
        wish.add_done_callback(self._wishes.discard)

    async def _welcomed(self, hello: Hello, socket: Socket, bus: str) -> bool:
        heard = self._heard_of(hello)
        held = HELD if self._is_held_by_another(hello) else ""
        answer = welcome(hello, bus, self.channels, heard, self._now(), held)
        await socket.send(answer)
        if answer.refused:
            await socket.close(answer.refused)
            return False
        again = self._heard.get(hello.bus) is heard
        self._heard[hello.bus] = heard
        self._pipeline.worker_came(hello, self._now(), again=again)
        return True

    def _is_held_by_another(self, hello: Hello) -> bool:
        heard = self._heard.get(hello.bus)
        if heard is None or hello.bus not in self._sockets:
            return False
        return heard.worker != hello.worker and self._pipeline.port_is_open(hello.bus)

    def _heard_of(self, hello: Hello) -> Heard:
        heard = self._heard.get(hello.bus)
        return heard if heard is not None and heard.worker == hello.worker else Heard(hello.worker)

    async def _replace(self, bus: str, socket: Socket) -> None:
        older = self._sockets.get(bus)
        self._sockets[bus] = socket
        if older is not None:
            self.channels[bus].closed(older)
            await older.close("another worker connected for this bus")

    async def _follow(self, hello: Hello, socket: Socket) -> None:
        channel = self.channels[hello.bus]
        ingest = Ingest(hello, self._heard[hello.bus], channel, self._pipeline, socket, self._now)
        ticking = asyncio.create_task(self._tick(ingest, socket))
        cause = NO_WORKER
        try:
            while self._sockets.get(hello.bus) is socket:
                await ingest.receive(await socket.receive())
        except MalformedSpeechError as error:
            cause = f"the bus worker was sent away: {error}"
            await socket.close(str(error))
        except ConnectionError:
            pass
        finally:
            ticking.cancel()
            self._gone(hello.bus, socket, cause)

    async def _tick(self, ingest: Ingest, socket: Socket) -> None:
        with suppress(ConnectionError):
            while ingest.silent_ticks < self._silent_ticks:
                await ingest.tick()
                await asyncio.sleep(TICK_S)
            self._gone(ingest.hello.bus, socket, SILENT)
            await socket.close(SILENT)

    def _gone(self, bus: str, socket: Socket, cause: str) -> None:
        self.channels[bus].closed(socket)
        if self._sockets.get(bus) is socket:
            del self._sockets[bus]
            self._pipeline.worker_went(bus, self._now(), cause)
