"""The connections of all bus workers: each is led to the bus of its token."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Mapping

from app.line.feed.bus_feed import BusFeed, WorkerConnection, send_away
from app.line.feed.holders import Credential, refusal
from app.line.live.change_recorder import ChangeRecorder
from app.line.pipeline import refusal_of_worker
from bus.contract import Hello, MalformedMessageError, decode_from_worker
from bus.instants import monotonic_now, unix_now
from bus.pacing import Bucket

TOO_OFTEN = "this bus was connected to too often; wait a minute"
HELLO_WITHIN_S = 10.0
HELLOS_PER_S, MAX_HELLOS_AT_ONCE = 0.5, 20.0


class Workers:
    """The feed up to the bus. ``feeds``: by bus; ``recorder``: of the site, for a worker whose bus is not
    configured."""

    def __init__(self, feeds: Mapping[str, BusFeed], recorder: ChangeRecorder) -> None:
        self._feeds = feeds
        self._recorder = recorder
        self.monotonic = monotonic_now
        self._hello_buckets: defaultdict[str, Bucket] = defaultdict(
            lambda: Bucket(HELLOS_PER_S, MAX_HELLOS_AT_ONCE)
        )
        """By token, so that one cannot use up what another has."""
        self._own_called: set[str] = set()
        """Buses whose own worker connected since `responds` was last called."""

    def responds(self, bus: str) -> bool:
        """Whether the child of this server for ``bus`` is linked, or connected since the last call: one whose
        bus another worker has is refused, and tries again."""
        called = bus in self._own_called
        self._own_called.discard(bus)
        return called or self._feeds[bus].has_own_worker

    async def serve(self, socket: WorkerConnection, credential: Credential) -> None:
        """Serve one connection from its hello to its end. Raises nothing that a worker could cause."""
        if credential.own:
            self._own_called.add(credential.bus)
        try:
            hello = await self._hello(socket, credential)
            await self._admit(hello, socket, credential)
        except (MalformedMessageError, TimeoutError) as error:
            await socket.close(str(error) or "the first message of a worker is Hello")
        except ConnectionError:
            return

    async def _hello(self, socket: WorkerConnection, credential: Credential) -> Hello:
        if self._hello_buckets[credential.token].pour(1.0, self.monotonic()) > 0.0:
            raise MalformedMessageError(TOO_OFTEN)
        async with asyncio.timeout(HELLO_WITHIN_S):
            data = await socket.receive()
        hello = decode_from_worker(data)
        if not isinstance(hello, Hello):
            raise MalformedMessageError("the first message of a worker is Hello")
        return hello

    async def _admit(self, hello: Hello, socket: WorkerConnection, credential: Credential) -> None:
        feed = self._feeds.get(credential.bus)
        refused = refusal(hello, credential, self._feeds)
        if feed is None:
            assert refused is not None  # the bus of the token is not configured
            self._recorder.note(refusal_of_worker(unix_now(), "", str(credential), refused))
            await send_away(socket, refused, unix_now())
        else:
            await feed.serve(hello, socket, credential, refused)
