"""Takes what another server of the site states of a request, and nothing of that from anyone else."""

from __future__ import annotations

from starlette.types import ASGIApp, Receive, Scope, Send

from app.errors import Problem
from app.routing.forwarding.hop import HEADER, ForgedHopError
from app.routing.site_servers import SiteServers, target_of
from app.server.admission.turns import ARRIVED_AT
from app.web.admission.security import PASSED_ON, refuse
from bus.instants import UnixTime
from bus.messages import Message

_NAME = HEADER.encode()
_SOCKET_SCHEMES = {"http": "ws", "https": "wss"}


class HopAdmission:
    """Middleware. The request of a true hop has the client, scheme and host name of the person, and the
    moment of its arrival at the first server, where that is earlier. A false one is refused: none of ours
    sends it."""

    def __init__(self, app: ASGIApp, servers: SiteServers) -> None:
        self._app = app
        self._servers = servers

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        given = [value for name, value in scope["headers"] if name == _NAME]
        if given:
            try:
                self._take(scope, given)
            except ForgedHopError:
                await refuse(scope, receive, send, Problem(400, "malformed", Message("hop_forged")))
                return
        await self._app(scope, receive, send)

    def _take(self, scope: Scope, given: list[bytes]) -> None:
        """Raises ForgedHopError, also where the clock of the store is not known: the age of a command is
        not known then."""
        servers = self._servers
        if len(given) > 1 or not servers.is_shared or not servers.is_clock_known:
            raise ForgedHopError
        hop = servers.open(given[0].decode("latin-1"), scope, target_of(scope))
        state = scope.setdefault("state", {})
        arrived = servers.clock.from_store(UnixTime(hop.arrived_at))
        state[ARRIVED_AT] = min(state.get(ARRIVED_AT, arrived), arrived)
        scope[PASSED_ON] = hop.sender
        scope["client"] = (hop.client, 0)
        scope["scheme"] = _SOCKET_SCHEMES[hop.scheme] if scope["type"] == "websocket" else hop.scheme
        kept = [pair for pair in scope["headers"] if pair[0] not in (_NAME, b"host")]
        scope["headers"] = [(b"host", hop.host.encode("latin-1")), *kept]
