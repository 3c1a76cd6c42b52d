"""The lines of this server and of its peers, each with its age, the worst first, and their tiles.

A tile is a set of fields in the reader's language, like that of a unit; pages that follow the lines get the
fields that changed. All of it is in memory, and is read again after a start.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Annotated

from app.core.web.formats import UNKNOWN
from app.core.web.services import service
from app.line.alarms.line_alarms import alarm_counts
from app.line.conditions.condition import PRIORITIES
from app.line.live.diagnosis import Level
from app.line.live.fields import Fields, Groups, Translator, put_fields, scan_text
from app.line.live.screen import NO_BREAK, and_more, verdict_line
from app.system.peers.summary import MAX_POINTS, LineSummary
from bus.instants import Clock, Monotonic, MonotonicClock, UnixTime, monotonic_now
from bus.messages import Message, term

STALE_AFTER_S = 6.0
"""The age above which a line is stale: three reports of a peer."""
AWAY_AFTER_S = 60.0
"""The age above which figures are not shown."""
_RANKS = {level: number for number, level in enumerate((*PRIORITIES, ""))}


@dataclass(eq=False, slots=True)
class Peer:
    """A server other than this one. ``number``: distinguishes it, its place in the configuration (from 1) if
    it is there; ``url``: of its pages; ``lines``: its last report by bus, at ``reported_at``, or at ``time``
    by its own clock; ``instance``: see `LineBoard`; ``fault``: why it is not read now."""

    number: int
    name: str
    url: str
    lines: Mapping[str, LineSummary] = field(default_factory=dict)
    reported_at: Monotonic | None = None
    instance: str = ""
    time: str = ""
    fault: Message | None = None

    def age_s(self, now: Monotonic) -> float | None:
        """Return the seconds since the peer's report; None if there was none."""
        return None if self.reported_at is None else now - self.reported_at


@dataclass(frozen=True, slots=True)
class LineOnBoard:
    """A line as last reported. ``age_s``: seconds since the report; ``peer``: its reporter, None for this
    server. ``summary`` None: the peer has reported no line, and ``bus`` is empty."""

    bus: str
    summary: LineSummary | None = None
    age_s: float | None = 0.0
    peer: Peer | None = None

    @property
    def key(self) -> str:
        """The group of the line's fields: a name that no unit can have (slugs have no underscore)."""
        return f"line_of/{self.bus}" if self.peer is None else f"line_of/{self.peer.number}/{self.bus}"

    @property
    def site(self) -> str:
        """The site of the line: the name of the peer as it is called here, or of this site."""
        if self.peer is not None:
            return self.peer.name
        return "" if self.summary is None else self.summary.site

    @property
    def href(self) -> str:
        """The address of the line's page; for a line of a peer, on the peer's server."""
        own = f"/?bus={self.bus}" if self.bus else "/"
        return own if self.peer is None else f"{self.peer.url}{own}"

    @property
    def is_stale(self) -> bool:
        """Whether the present state of the line is unknown."""
        return self.age_s is None or self.age_s > STALE_AFTER_S

    @property
    def is_away(self) -> bool:
        """Whether the figures of the line are too old to be shown."""
        return self.age_s is None or self.age_s > AWAY_AFTER_S

    @property
    def rank(self) -> tuple[int, int, int, str, str]:
        """The sort key, worst first: by priority (for a stale line at least high), then by alarms."""
        name = "" if self.peer is None else self.peer.name
        level, waiting, active = "", 0, 0
        if self.summary is not None:
            level = self.summary.level
            waiting, active = sum(self.summary.waiting.values()), sum(self.summary.active.values())
        known = min(_RANKS[level], _RANKS["high"]) if self.is_stale else _RANKS[level]
        return known, -waiting, -active, name, self.bus


@dataclass(eq=False, repr=False)
class LineBoard:
    """The board of lines. ``own``: makes the summaries of this server's lines when they are wanted;
    ``instance``: names this run of this server, which thus detects that a peer is itself."""

    own: Callable[[], Iterable[LineSummary]]
    peers: list[Peer] = field(default_factory=list)
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
        """Take over the report of a peer. Return the fault if the peer is this server or another peer, or if
        the report is a copy of the one before, which says nothing of the present."""
        if instance == self.instance:
            return Message("peer_is_this_server")
        same = next((p for p in self.peers if p is not peer and p.instance == instance and not p.fault), None)
        if same is not None:
            return Message.of("peer_is_other", name=same.name)
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


WIDTH, HEIGHT = 240, 40
MIN_REACH = 0.02
"""The least height of the drawing, as a part of the value: noise should not look like movement."""
MINUTE_S, HOUR_S = 60, 3600
LONG_S, LONG_MINUTES_S = 2 * MINUTE_S, 2 * HOUR_S
STATES = {
    "at_speed": "line_n_at_speed",
    "ramping": "line_n_ramping",
    "at_zero": "line_n_at_zero",
    "off_speed": "line_n_off_speed",
}
"""The text for the number of units in a state."""
MAX_NAMES = 6
"""The most abnormal units that are named; beyond it a number."""
_NO_REPORT: tuple[tuple[float, str, int], ...] = (
    (LONG_S, "line_overdue_seconds", 1),
    (LONG_MINUTES_S, "line_overdue_minutes", MINUTE_S),
    (inf, "line_overdue_hours", HOUR_S),
)
"""The greatest age, the text that nothing was reported for so long, and its unit in seconds."""
_NEVER: Fields = {
    **dict.fromkeys(("place", "last", "counts", "alarm_mark", "alarms", "abnormal", "spark"), ""),
    **dict.fromkeys(("recipe", "event", "event_at"), ""),
    "speed": UNKNOWN,
    "scan": UNKNOWN,
}
"""The fields of a line whose figures are not known."""


def tile_fields(line: LineOnBoard, translator: Translator, now: UnixTime) -> Fields:
    """Return the fields of a line. ``quality``: whether its state is current; ``last``: its last state if it
    is not, else why its cause is no alarm yet."""
    summary, level = line.summary, shown_level(line)
    fields = _NEVER | {
        "level": level,
        "level_text": translator.t(level),
        "quality": "stale" if line.is_stale else "live",
    }
    if summary is None:
        return fields | {"verdict": translator.t(no_report(line))}
    place, verdict = _place_and_verdict(summary, translator, now)
    if line.is_stale:
        before = f"{translator.isolated(place)} · {verdict}" if place else verdict
        was = translator.t(Message.of("line_was", verdict=before))
        fields |= {"verdict": translator.t(no_report(line)), "last": was}
    else:
        fields |= {"place": place, "verdict": verdict, "last": _not_yet(summary, translator)}
    return fields if line.is_away else fields | _figures(summary, translator, now)


def _figures(summary: LineSummary, translator: Translator, now: UnixTime) -> Fields:
    return {
        "counts": _counts(summary, translator),
        "alarm_mark": _mark(summary),
        "alarms": _alarms(summary, translator),
        "abnormal": _abnormal(summary, translator),
        "scan": scan_text(translator, 1 / summary.scan_hz if summary.scan_hz else 0.0),
        "speed": _speed(summary, translator),
        "spark": outline(summary.speeds),
        "recipe": translator.t(summary.recipe) if summary.recipe is not None else "",
    } | _event(summary, translator, now)


def _abnormal(summary: LineSummary, translator: Translator) -> str:
    """Return the names of several abnormal units; of many, the first and the number of the others."""
    names = summary.abnormal
    if len(names) < 2:
        return ""
    shown = ", ".join(translator.isolated(name).replace(" ", NO_BREAK) for name in names[:MAX_NAMES])
    more = and_more(len(names) - MAX_NAMES, translator)
    return f"{translator.t(term('Abnormal'))}: {shown} {more}".rstrip()


def _event(summary: LineSummary, translator: Translator, now: UnixTime) -> Fields:
    event = summary.event
    if event is None:
        return {"event": "", "event_at": ""}
    at = translator.formats.since(UnixTime(event.at), now)
    return {"event": translator.t(event.text), "event_at": at}


def shown_level(line: LineOnBoard) -> Level:
    """Return the priority of a line; at least high if its present state is not known."""
    level = "" if line.summary is None else line.summary.level
    return "high" if line.is_stale and level not in ("urgent", "high") else level


def verdict_text(summary: LineSummary, translator: Translator, now: UnixTime) -> str:
    """Return the verdict, after the name of the unit that it is about."""
    place, text = _place_and_verdict(summary, translator, now)
    return f"{translator.isolated(place)} · {text}" if place else text


def _place_and_verdict(summary: LineSummary, translator: Translator, now: UnixTime) -> tuple[str, str]:
    """Return place and verdict of a line; the place is empty if the verdict is about the line."""
    if summary.cause is None:
        return "", translator.t(summary.verdict)
    place = "" if summary.place == summary.bus else summary.place
    if place and (more := and_more(summary.alike - 1, translator)):
        place = f"{translator.isolated(place)} {more}"
    return place, verdict_line(summary.cause.cause(summary.level), translator, now)


def _not_yet(summary: LineSummary, translator: Translator) -> str:
    left_s = 0 if summary.cause is None else summary.cause.alarm_in_s
    return translator.t(Message.of("line_alarm_follows", n=left_s)) if left_s else ""


def no_report(line: LineOnBoard) -> Message:
    """Return the text that a peer does not report a line, since when and why."""
    peer = line.peer
    assert peer is not None, "a line of this server is always reported"
    name = peer.name
    if line.age_s is None or not line.is_stale:
        if peer.fault is None:
            return Message.of("peer_has_no_lines" if peer.reported_at else "peer_awaited", peer=name)
        return Message.of("peer_not_read", peer=name, reason=peer.fault)
    _, code, unit_s = next(row for row in _NO_REPORT if line.age_s < row[0] or row[0] == inf)
    overdue = Message.of(code, server=name, n=int(line.age_s // unit_s))
    return overdue if peer.fault is None else Message.of("peer_overdue", overdue=overdue, reason=peer.fault)


def outline(speeds: list[float | None]) -> str:
    """Return an SVG path of speeds over ten minutes, the newest at the right; an unknown value leaves a
    gap."""
    known = [speed for speed in speeds if speed is not None]
    if not known:
        return ""
    middle = (min(known) + max(known)) / 2
    reach = max(max(known) - min(known), abs(middle) * MIN_REACH) or 1.0
    path, pen = "", "M"
    for place, speed in enumerate(speeds, MAX_POINTS - len(speeds)):
        if speed is None:
            pen = "M"
            continue
        x = place * WIDTH / (MAX_POINTS - 1)
        y = HEIGHT / 2 - (speed - middle) / reach * (HEIGHT - 4)
        path += f"{pen}{x:.0f} {y:.1f}"
        pen = "L"
    return path


def _counts(summary: LineSummary, translator: Translator) -> str:
    states = summary.states
    parts = [Message.of("line_live_of", n=states.get("online", 0), units=summary.units)]
    parts += [Message.of(code, n=states[state]) for state, code in STATES.items() if states.get(state)]
    return " · ".join(map(translator.t, parts))


def _mark(summary: LineSummary) -> str:
    """Return the mark of the first alarm. A list has active alarms before cleared ones, so without an active
    alarm the first has cleared."""
    cleared = summary.alarm_priority and not summary.active and not summary.unknown
    return f"{summary.alarm_priority} cleared" if cleared else summary.alarm_priority


def _alarms(summary: LineSummary, translator: Translator) -> str:
    """Return the number of active and unknown alarms, and of those that wait for an acknowledgement."""
    active, waiting = sum(summary.active.values()), sum(summary.waiting.values())
    counts = alarm_counts(active, waiting, summary.unknown)
    return " · ".join(translator.t(count) for count in counts if count is not None)


def _speed(summary: LineSummary, translator: Translator) -> str:
    newest = summary.speeds[-1] if summary.speeds else None
    if newest is None:
        return UNKNOWN
    shape = "g" if summary.decimals is None else f".{summary.decimals}f"
    return translator.formats.point(f"{newest:{shape}}")


class LineTiles:
    """The lines as pages show them. ``clock``: Unix time in seconds."""

    def __init__(self, board: LineBoard, clock: Clock) -> None:
        self.board = board
        self._clock = clock
        self._shown: dict[str, Groups] = {}

    def shown(self, translator: Translator) -> Groups:
        """Return the present fields of all lines, the worst first."""
        return self.fields_of(self.board.lines(), translator)

    def fields_of(self, lines: list[LineOnBoard], translator: Translator) -> Groups:
        """Return the fields of these lines, in their order."""
        now = self._clock()
        return {
            line.key: tile_fields(line, translator, now) | {"rank": str(rank)}
            for rank, line in enumerate(lines)
        }

    def changes(self, translator: Translator) -> Groups:
        """Return the fields that differ from those of the last call for this language. A line that has
        disappeared has the quality ``gone``."""
        shown = self._shown.setdefault(translator.language.tag, {})
        changed, fields = Groups(), self.shown(translator)
        for key in shown.keys() - fields.keys():
            del shown[key]
            changed[key] = {"quality": "gone"}
        for key, each in fields.items():
            changed |= put_fields(shown, key, each)
        return changed

    def forget(self, tag: str) -> None:
        """Forget the fields sent in a language, as no page follows the lines in it."""
        self._shown.pop(tag, None)


LineTilesService = Annotated[LineTiles, service(LineTiles)]
