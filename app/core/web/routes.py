"""The guard of every route: its grant, the bound of its body, and its turn.

Every route declares a role or is public, and is not served otherwise. Costly requests have turns: an account
has few at a time, and while its other requests wait, those of other people continue. Requests without a
caller have turns by address, so that a flood of them delays itself.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from functools import cached_property
from math import ceil, floor, inf
from operator import attrgetter
from threading import RLock
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.routing import APIRoute, APIWebSocketRoute
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.routing import Match, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.core.server.addresses import source_of
from app.core.server.turns import FairQueue, TooManyWaitingError
from app.core.web.access import Requires, Viewer, address_of, caller_of, public
from app.core.web.problems import too_many_requests
from app.core.web.request_rules import HEALTH, MAX_PLAIN_BODY_BYTES, bounded, refuse
from app.core.web.services import service_of
from app.errors import Problem
from bus.instants import Monotonic
from bus.pacing import Bucket


def as_get(scope: Scope, send: Send) -> tuple[Scope, Send]:
    """Return a HEAD request as the GET that its route knows, and the function that sends its response. The
    server, which knows the method, leaves the body out; a stream ends with its first piece."""
    is_complete = False

    async def send_head(message: Message) -> None:
        nonlocal is_complete
        if is_complete:
            return
        await send(message)
        if message.get("more_body"):
            # A stream learns from ``receive`` that the response is complete.
            is_complete = True
            await send({"type": "http.response.body", "body": b"", "more_body": False})

    return {**scope, "method": "GET"}, send_head


_ANALYZING = RLock()


class GuardedRoute(APIRoute):
    """A route behind its `RouteGuard`, for ``APIRouter(route_class=GuardedRoute)``.

    FastAPI analyzes a route when it is declared. This one is analyzed when it is first used: for all 270 that
    takes 0.2 s and 8 MiB, and a server is asked for few of them.
    """

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:
        """Note the parts that find the route of a request, and its address; ``options`` are FastAPI's."""
        methods = options.get("methods") or ["GET"]
        described = options.get("include_in_schema", True)
        name = options.get("name")
        Route.__init__(self, path, endpoint, methods=methods, name=name, include_in_schema=described)
        self.methods = {method.upper() for method in methods}
        self._beginning = path.partition("{")[0]
        self._options: dict[str, Any] | None = options
        del self.app  # It is the analyzed one's.

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Match the path, after a look at its beginning: a request passes some hundred routes before its
        own."""
        if not scope["path"].startswith(self._beginning):
            return Match.NONE, {}
        return super().matches(scope)

    def complete(self, options: dict[str, Any]) -> dict[str, Any]:
        """Return the options of FastAPI's route from those of its declaration."""
        return options

    def __getattr__(self, name: str) -> Any:
        """Return an attribute from the analysis. A thread that writes the OpenAPI document may wait for
        it."""
        with _ANALYZING:
            options = self.__dict__.pop("_options", None)
            if options is not None:
                super().__init__(self.path, self.endpoint, **self.complete(options))
        return object.__getattribute__(self, name)

    @cached_property
    def guard(self) -> RouteGuard:
        """The app of this route behind its guard."""
        return RouteGuard(self)

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] in (self.methods or ()):
            await self.guard(scope, receive, send)
        else:
            await super().handle(scope, receive, send)  # which refuses the method


def calls_of(route: APIRoute | APIWebSocketRoute) -> Iterator[Any]:
    """Yield all functions that FastAPI calls before a route."""
    waiting = [route.dependant]
    while waiting:
        for dependency in waiting.pop().dependencies:
            yield dependency.call
            waiting.append(dependency)


def refuse_unguarded(app: FastAPI) -> None:
    """Raise RuntimeError naming the first route that has no guard."""
    for route in app.routes:
        if isinstance(route, APIRoute) and not isinstance(route, GuardedRoute):
            raise RuntimeError(f"{route.path} has no guard: declare it with route_class=GuardedRoute")


class RouteGuard:
    """The guard of a route: it grants the role that a route requires, bounds the body and waits for a turn,
    before the route reads anything: FastAPI reads and parses a body first and checks the role then.

    A route with files declares their size by FastAPI's ``max_body_size``. A `SEARCH` or a `DOWNLOAD` has its
    turn until its response is sent. Every other GET has it until its response is made: rendering a page of a
    long line takes the event loop tens of milliseconds, and the requests of others come in between; a stream
    that lasts delays no other request.
    """

    def __init__(self, route: APIRoute) -> None:
        """Make the guard. Raise RuntimeError for a route that declares neither a role nor that it is public:
        it is never served."""
        calls = list(calls_of(route))
        self._app = route.app
        self._requirements = [call for call in calls if isinstance(call, Requires)]
        if not self._requirements and public not in calls:
            raise RuntimeError(f"{route.path} declares no role: add Requires(Role.…) or public to it")
        self._most_bytes = route.max_body_size or MAX_PLAIN_BODY_BYTES
        self._turns: Callable[[Turns], FairQueue[str]] | None = None
        self._is_short = False
        if SEARCH in route.dependencies:
            self._turns = attrgetter("searches")
        elif DOWNLOAD in route.dependencies:
            self._turns = attrgetter("downloads")
        elif "GET" in (route.methods or ()):
            self._turns, self._is_short = attrgetter("reads"), True

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        connection = HTTPConnection(scope)
        for requirement in self._requirements:
            await requirement.granted_once(connection)
        receive, caller = bounded(scope, receive, self._most_bytes), caller_of(connection)
        if self._turns is None or caller is None:
            await self._app(scope, receive, send)
            return
        async with AsyncExitStack() as turn:

            async def send_after_turn(message: Message) -> None:
                await turn.aclose()
                await send(message)

            turns = self._turns(service_of(connection, Turns))
            await turn.enter_async_context(turns.turn(caller.account))
            await self._app(scope, receive, send_after_turn if self._is_short else send)


MAX_AT_ONCE = 2
MAX_WAITING = 30
"""The most searches, and the most downloads, of an account that may wait."""
MAX_READS = 2
REST, MOST_REST_S = 2.0, 0.5
"""The factor by which a read's place stays free longer than the read took, and the most seconds. A command
needs the event loop some twenty times, and would otherwise wait for another page of that account each
time."""
MAX_WAITING_READS = 200
"""The most other reads of an account that may wait."""


@dataclass(frozen=True)
class Turns:
    """The queues of one app, each by account."""

    searches: FairQueue[str] = field(default_factory=lambda: FairQueue(inf, MAX_AT_ONCE, MAX_WAITING))
    downloads: FairQueue[str] = field(default_factory=lambda: FairQueue(inf, MAX_AT_ONCE, MAX_WAITING))
    reads: FairQueue[str] = field(
        default_factory=lambda: FairQueue(
            inf, MAX_READS, MAX_WAITING_READS, rest=REST, most_rest_s=MOST_REST_S
        )
    )
    """The queue of everything else that is read."""


async def _search(_: Viewer) -> None: ...


async def _download(_: Viewer) -> None: ...


SEARCH, DOWNLOAD = Depends(_search), Depends(_download)
"""For ``dependencies=[SEARCH]`` of a route, which has its turn from before it runs until its response is sent
(`app.core.web.routes.RouteGuard`)."""


ANONYMOUS_AT_ONCE, AT_ONCE_OF_ADDRESS = 2, 1
ANONYMOUS_WAITING, MAX_WAITING_OF_ADDRESS = 512, 64
ANONYMOUS_REST = 4.0
"""Rendering the login page takes the event loop milliseconds, and a command needs the loop some twenty times:
without the rest it would wait for another page each time."""


class AnonymousLimiter:
    """The ASGI middleware that serves a request without a caller in its turn, and only once its body has
    arrived. Otherwise a burst of them would begin in one iteration of the event loop, before everyone else's
    requests. ``exempt``: paths that cost the loop next to nothing, or have other turns."""

    def __init__(self, app: ASGIApp, exempt: Collection[str] = (HEALTH,)) -> None:
        self._app = app
        self._exempt = exempt
        # Half of the waiting places is for known keys, and no address is known.
        self._turns: FairQueue[str] = FairQueue(
            ANONYMOUS_AT_ONCE,
            AT_ONCE_OF_ADDRESS,
            MAX_WAITING_OF_ADDRESS,
            2 * ANONYMOUS_WAITING,
            ANONYMOUS_REST,
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        is_exempt = scope["type"] != "http" or scope["path"] in self._exempt
        if is_exempt or caller_of(HTTPConnection(scope)) is not None:
            await self._app(scope, receive, send)
            return
        try:
            await self._serve(scope, bounded(scope, receive, MAX_PLAIN_BODY_BYTES), send)
        except Problem as problem:
            await refuse(scope, receive, send, problem)
        except TooManyWaitingError:
            await refuse(scope, receive, send, too_many_requests())

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        connection = Request(scope, receive)
        try:
            body = await connection.body()
        except ClientDisconnect:
            return
        async with self._turns.turn(source_of(address_of(connection)), known=False):
            await self._app(scope, _replaying(body, receive), send)


def _replaying(body: bytes, receive: Receive) -> Receive:
    """Return a ``receive`` that gives a body that was already read."""
    begun: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def replaying() -> Message:
        return begun.pop() if begun else await receive()

    return replaying


@dataclass(frozen=True, slots=True)
class RateLimit:
    """A limit of a rate, for the ``RateLimit`` headers. ``limit``: the most at once; ``remaining``: the
    number left now; ``reset_s``: seconds until all are there again.

    The three headers are those of the IETF draft "RateLimit header fields for HTTP" up to its version 6,
    which clients and gateways read. Its later versions have one structured field, which few read.
    """

    limit: int
    remaining: int
    reset_s: float

    @classmethod
    def of_bucket(cls, bucket: Bucket, now: Monotonic) -> RateLimit:
        """Return the limit of a bucket now."""
        level = bucket.level(now)
        return cls(floor(bucket.capacity), max(0, floor(bucket.capacity - level)), level / bucket.per_s)

    @property
    def headers(self) -> dict[str, str]:
        """The headers by their names."""
        return {
            "RateLimit-Limit": str(self.limit),
            "RateLimit-Remaining": str(self.remaining),
            "RateLimit-Reset": str(ceil(self.reset_s)),
        }
