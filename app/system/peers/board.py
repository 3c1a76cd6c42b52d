"""The lines of this server and of its peers, each with its age, the worst first. All of it is in memory, and
read again after a start."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from app.line.conditions.condition import PRIORITIES
from app.system.peers.settings import PeerSettings
from app.system.peers.summary import LineSummary
from bus.instants import Monotonic, MonotonicClock, monotonic_now
from bus.messages import Message

STALE_AFTER_S = 6.0
"""Three reports of a peer."""
AWAY_AFTER_S = 60.0
"""Older figures are not shown."""
_RANKS = {level: number for number, level in enumerate((*PRIORITIES, ""))}


@dataclass(eq=False, slots=True)
class Peer:
    """Another server. ``number``: its place in the configuration, from 1; ``lines``: by bus, as it reported
    them last, at ``reported_at``, or at ``time`` by its own clock; ``instance``: see `LineBoard`; ``fault``:
    why it is not read now."""

    number: int
    settings: PeerSettings
    lines: Mapping[str, LineSummary] = field(default_factory=dict)
    reported_at: Monotonic | None = None
    instance: str = ""
    time: str = ""
    fault: Message | None = None

    def age_s(self, now: Monotonic) -> float | None:
        """Return the seconds since its report; None where there was none."""
        return None if self.reported_at is None else now - self.reported_at


@dataclass(frozen=True, slots=True)
class LineOnBoard:
    """A line as reported last. ``age_s``: seconds since the report; ``peer``: who reports it, None for this
    server. ``summary`` None: the peer has reported no line, and ``bus`` is empty."""

    bus: str
    summary: LineSummary | None = None
    age_s: float | None = 0.0
    peer: Peer | None = None

    @property
    def key(self) -> str:
        """The group of its fields: a name that no unit can have (a slug holds no underscore)."""
        return f"line_of/{self.bus}" if self.peer is None else f"line_of/{self.peer.number}/{self.bus}"

    @property
    def site(self) -> str:
        """Return where it is: the name of the peer as it is called here, or that of this site."""
        if self.peer is not None:
            return self.peer.settings.name
        return "" if self.summary is None else self.summary.site

    @property
    def href(self) -> str:
        """Return the address of its page; of a line of a peer, that on its server."""
        own = f"/?bus={self.bus}" if self.bus else "/"
        return own if self.peer is None else f"{self.peer.settings.url}{own}"

    @property
    def is_stale(self) -> bool:
        """Whether its present state is unknown."""
        return self.age_s is None or self.age_s > STALE_AFTER_S

    @property
    def is_away(self) -> bool:
        """Whether its figures are too old to be shown."""
        return self.age_s is None or self.age_s > AWAY_AFTER_S

    @property
    def rank(self) -> tuple[int, int, int, str, str]:
        """The worst first: by priority, where one that is stale counts as high at least; then alarms."""
        name = "" if self.peer is None else self.peer.settings.name
        level, waiting, active = "", 0, 0
        if self.summary is not None:
            level = self.summary.level
            waiting, active = sum(self.summary.waiting.values()), sum(self.summary.active.values())
        known = min(_RANKS[level], _RANKS["high"]) if self.is_stale else _RANKS[level]
        return known, -waiting, -active, name, self.bus


@dataclass(eq=False, repr=False)
class LineBoard:
    """``own``: makes the summaries of the lines of this server when they are wanted; ``instance``: names this
    run of this server, so that one that finds its own in the report of a peer knows that it reads itself."""

    own: Callable[[], Iterable[LineSummary]]
    peers: tuple[Peer, ...] = ()
    clock: MonotonicClock = monotonic_now
    instance: str = field(default_factory=lambda: secrets.token_hex(8))

    def lines(self, *, own: bool = False) -> list[LineOnBoard]:
        """Return every line, the worst first; ``own``: only those of this server."""
        found = [LineOnBoard(line.bus, line) for line in self.own()]
        if not own:
            now = self.clock()
            found += [line for peer in self.peers for line in _lines_of(peer, now)]
        return sorted(found, key=lambda line: line.rank)

    def put(self, peer: Peer, lines: Mapping[str, LineSummary], instance: str, time: str) -> Message | None:
        """Take over the report of a peer. Return the fault of one that is this server or another peer, or of
        a copy of the report before, which says nothing of the present."""
        if instance == self.instance:
            return Message("peer_is_this_server")
        same = next((p for p in self.peers if p is not peer and p.instance == instance and not p.fault), None)
        if same is not None:
            return Message.of("peer_is_other", name=same.settings.name)
        if (instance, time) == (peer.instance, peer.time):
            return Message("peer_report_copied")
        peer.lines, peer.time, peer.reported_at, peer.instance, peer.fault = (
            lines,
            time,
            self.clock(),
            instance,
            None,
        )
        return None


def _lines_of(peer: Peer, now: Monotonic) -> list[LineOnBoard]:
    age_s = peer.age_s(now)
    if not peer.lines:
        return [LineOnBoard("", None, age_s, peer)]
    return [LineOnBoard(bus, line, age_s, peer) for bus, line in peer.lines.items()]
