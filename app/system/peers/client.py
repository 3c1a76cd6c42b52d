"""The report of lines of ``GET /sites``, and the client that reads it from each peer.

One schema is for both directions, so that a peer is trusted only with what this server would send. The client
has one connection to each peer, bounded in bytes and time.
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Mapping
from contextlib import asynccontextmanager
from datetime import datetime
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, NotRequired, cast

import msgspec
import structlog
from pydantic import Field, TypeAdapter
from typing_extensions import TypedDict

from app.core.server.settings import SecretFileError, read_secret_text
from app.core.web.shape import Instant, MaybeInstant, MessageShown, iso, maybe_shown, message_shown
from app.errors import is_refused_certificate, network_cause, system_error
from app.line.alarms.api import AlarmPriorityShown
from app.line.conditions.catalogue import tile_text
from app.line.live.fields import STATE_WORDS, TURNING, Translator
from app.system.peers.board import LineBoard, LineOnBoard, Peer, no_report, shown_level, verdict_text
from app.system.peers.settings import PeerSettings
from app.system.peers.summary import MAX_POINTS, CauseSummary, EventSummary, LineSummary
from app.version import VERSION
from bus.errors import LinesideError
from bus.instants import Monotonic, UnixTime
from bus.messages import MAX_TEXT, TEXTS, Message
from bus.validation import OneLine

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    import httpx


MAX_LINES = 255
"""The most lines that are read of a peer."""
MAX_AT = 1e11
"""The year 5138: later times have no date in any time zone."""


Name = Annotated[OneLine, Field(max_length=100)]
Word = Annotated[str, Field(max_length=30, pattern="^[A-Za-z_]*$")]
Count = Annotated[int, Field(ge=0, le=1_000_000)]
Decimals = Annotated[int, Field(ge=0, le=4)]
Figure = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]
AlarmCount = Annotated[
    dict[AlarmPriorityShown, Count], Field(description="By priority; one without alarms is left out.")
]
BusSlug = Annotated[str, Field(pattern="^[a-z0-9-]*$", max_length=40)]


class LineAlarmsShown(TypedDict):
    """The numbers of alarms of a line, and its first alarm."""

    active: AlarmCount
    unacknowledged: AlarmCount
    unknown: Annotated[
        NotRequired[Count],
        Field(description="How many were active and may have ended since, as nobody reads their units."),
    ]
    first: Annotated[MessageShown | None, Field(description="Its text; null: there is none.")]
    first_priority: AlarmPriorityShown | None


class LineCauseShown(TypedDict):
    """The cause of a line's abnormal state, as the parts of its verdict."""

    code: Annotated[str, Field(max_length=60)]
    since: Annotated[MaybeInstant, Field(description="null: not known.")]
    exact: Annotated[bool, Field(description="False: since then at least.")]
    motion: Annotated[Word, Field(description="How the unit moves, where that says more.")]
    mode: Annotated[Word, Field(description="LOCAL, KEYLOCK, … where that is the cause.")]
    why: Annotated[MessageShown | None, Field(description="What the cause itself gives as a reason.")]


class LineEventShown(TypedDict):
    """The last event of a line."""

    at: Instant
    text: MessageShown


class LineOfSite(TypedDict):
    """A line. All fields except ``bus``, ``peer``, ``url``, ``stale``, ``age_s`` and ``verdict`` are as
    last reported, null if never reported."""

    bus: Annotated[BusSlug, Field(description="Empty for a peer that has not reported any.")]
    peer: Annotated[str | None, Field(description="Who reports it; null: this server.")]
    url: Annotated[str | None, Field(description="Its page on the server of that peer.")]
    site: Name | None
    stale: Annotated[bool, Field(description="It is no longer reported: its state is not known.")]
    age_s: Annotated[float | None, Field(description="Seconds since the report; null: there is none.")]
    level: Annotated[
        AlarmPriorityShown | None, Field(description="Of the verdict; null: nothing is abnormal.")
    ]
    verdict: MessageShown
    place: Annotated[Name | None, Field(description="The unit or bus that the verdict is about.")]
    alike: NotRequired[Annotated[Count | None, Field(description="How many units have that cause.")]]
    cause: LineCauseShown | None
    units: Annotated[Count | None, Field(description="How many are configured.")]
    states: Annotated[
        dict[Word, Count] | None,
        Field(description="How many units are online, at_speed, ramping, at_zero, off_speed."),
    ]
    alarms: LineAlarmsShown | None
    scan_hz: Annotated[Figure | None, Field(description="Scans per second.")]
    speeds: Annotated[
        list[Figure | None] | None,
        Field(
            max_length=MAX_POINTS,
            description="Of the first unit, in display units, a point each 10 s, the newest last.",
        ),
    ]
    measure: Annotated[Name | None, Field(description="What those display units are.")]
    decimals: NotRequired[Annotated[Decimals | None, Field(description="How many decimals they have.")]]
    recipe: Annotated[MessageShown | None, Field(description="The one loaded last.")]
    event: LineEventShown | None


class PeerOfSite(TypedDict):
    """A server other than this one, whose lines are read."""

    name: str
    url: str
    age_s: Annotated[float | None, Field(description="Seconds since its report; null: there is none.")]
    fault: Annotated[MessageShown | None, Field(description="Why it is not read now; null: it is.")]


class LinesOfSites(TypedDict):
    """The lines of this server and its peers, the worst first."""

    time: Instant
    version: Annotated[str, Field(max_length=60, description="Of this Lineside.")]
    instance: Annotated[str, Field(max_length=60, description="Names this run of this server.")]
    lines: list[LineOfSite]
    peers: list[PeerOfSite]


class _Version(msgspec.Struct):
    version: str = ""


class ReportError(ValueError):
    """Raised for a report of another schema. ``version``: of the reporting Lineside; empty if unstated."""

    def __init__(self, version: str) -> None:
        super().__init__("not of this schema")
        self.version = version


def board_json(board: LineBoard, english: Translator, now: UnixTime, *, own: bool = False) -> LinesOfSites:
    """Return the report of this server; ``own``: without its peers."""
    return {
        "time": iso(now),
        "version": VERSION,
        "instance": board.instance,
        "lines": [_line_json(line, english, now) for line in board.lines(own=own)],
        "peers": [] if own else [_peer_json(peer, board.clock()) for peer in board.peers],
    }


def _peer_json(peer: Peer, now: Monotonic) -> PeerOfSite:
    age_s = peer.age_s(now)
    return {
        "name": peer.name,
        "url": peer.url,
        "age_s": None if age_s is None else round(age_s, 3),
        "fault": maybe_shown(peer.fault),
    }


def _line_json(line: LineOnBoard, english: Translator, now: UnixTime) -> LineOfSite:
    summary, peer = line.summary, line.peer
    given: dict[str, Any] = dict.fromkeys(LineOfSite.__annotations__)
    given |= {
        "bus": line.bus,
        "peer": None if peer is None else peer.name,
        "url": None if peer is None else line.href,
        "stale": line.is_stale,
        "age_s": None if line.age_s is None else round(line.age_s, 3),
        "level": shown_level(line) or None,
        "verdict": message_shown(no_report(line)) if line.is_stale or summary is None else None,
    }
    if summary is not None:
        given |= _summary_json(summary)
        given["verdict"] = given["verdict"] or _verdict(summary, english, now)
    return cast(LineOfSite, given)


def _summary_json(summary: LineSummary) -> dict[str, Any]:
    cause, event = summary.cause, summary.event
    return {
        "site": summary.site,
        "place": summary.place or None,
        "alike": summary.alike,
        "cause": cause
        and {
            "code": cause.code,
            "since": None if cause.since is None else iso(UnixTime(cause.since)),
            "exact": cause.is_exact,
            "motion": cause.motion,
            "mode": cause.mode,
            "why": maybe_shown(cause.why),
        },
        "units": summary.units,
        "states": summary.states,
        "alarms": {
            "active": summary.active,
            "unacknowledged": summary.waiting,
            "unknown": summary.unknown,
            "first": maybe_shown(summary.alarm),
            "first_priority": summary.alarm_priority or None,
        },
        "scan_hz": summary.scan_hz,
        "speeds": summary.speeds,
        "measure": summary.measure or None,
        "decimals": summary.decimals,
        "recipe": maybe_shown(summary.recipe),
        "event": event and {"at": iso(UnixTime(event.at)), "text": message_shown(event.text)},
    }


def _verdict(summary: LineSummary, english: Translator, now: UnixTime) -> MessageShown:
    cause = summary.cause
    if cause is None:
        return message_shown(summary.verdict)
    params = {"place": summary.place, "motion": cause.motion, "mode": cause.mode}
    given = {name: value for name, value in params.items() if value}
    return {"code": cause.code, "params": given, "detail": verdict_text(summary, english, now)}


@cache
def _schema() -> TypeAdapter[LinesOfSites]:
    return TypeAdapter(LinesOfSites)


def read_report(content: bytes) -> tuple[dict[str, LineSummary], str, str]:
    """Return the lines of a report by bus, the instance that wrote it, and its time by that clock. Raise
    ReportError."""
    try:
        report = _schema().validate_json(content, strict=True)
        lines = [_summary(line) for line in report["lines"][:MAX_LINES]]
    except (ValueError, OverflowError, RecursionError, msgspec.MsgspecError):
        raise ReportError(_version_in(content)) from None
    return {line.bus: line for line in lines}, report["instance"], report["time"]


def _version_in(content: bytes) -> str:
    try:
        return msgspec.json.decode(content, type=_Version).version[:60]
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return ""


def _summary(line: LineOfSite) -> LineSummary:
    """Return a line of a peer. Raise ValueError, OverflowError or MsgspecError for a line that cannot be
    shown."""
    alarms, cause, event = line["alarms"], line["cause"], line["event"]
    if not line["bus"] or alarms is None or line["site"] is None:
        raise ValueError("a line of the peer itself has a summary")
    is_known = cause is None or _has_words(cause)
    return LineSummary(
        bus=line["bus"],
        site=line["site"],
        level=line["level"] or "",
        verdict=_message(line["verdict"]),
        units=line["units"] or 0,
        states=line["states"] or {},
        active=alarms["active"],
        waiting=alarms["unacknowledged"],
        unknown=alarms.get("unknown", 0),
        place=line["place"] or "" if is_known else "",
        alike=(is_known and line.get("alike")) or 1,
        cause=_cause(cause) if cause and is_known else None,
        alarm=_maybe_message(alarms["first"]),
        alarm_priority=alarms["first_priority"] or "",
        scan_hz=line["scan_hz"],
        speeds=line["speeds"] or [],
        measure=line["measure"] or "",
        decimals=line.get("decimals"),
        recipe=_maybe_message(line["recipe"]),
        event=EventSummary(_unix(event["at"]), _message(event["text"])) if event else None,
    )


def _has_words(cause: LineCauseShown) -> bool:
    """Return whether this version has words for the cause of another version."""
    is_motion = cause["motion"] in STATE_WORDS or cause["motion"] == TURNING
    return is_motion and cause["code"] != "ramping" and tile_text(cause["code"]) is not None


def _cause(cause: LineCauseShown) -> CauseSummary:
    since = None if cause["since"] is None else _unix(cause["since"])
    why = _maybe_message(cause["why"])
    return CauseSummary(cause["code"], since, cause["exact"], cause["motion"], cause["mode"], why)


def _message(given: MessageShown) -> Message:
    """Return a message of another server; if this version lacks its text, the English text that came with
    it."""
    if given["code"] in TEXTS:
        return msgspec.convert(given, Message)
    return Message.of("peer_text", text=given["detail"][:MAX_TEXT])


def _maybe_message(given: MessageShown | None) -> Message | None:
    return None if given is None else _message(given)


def _unix(given: str) -> float:
    at = datetime.fromisoformat(given).timestamp()
    if not 0 <= at <= MAX_AT:
        raise ValueError(given)
    return at


PATH = "/api/v1/sites"
EVERY_S = 2.0
REFUSED_EVERY_S = 10.0
"""The seconds between readings after a refusal, which a person has to remedy."""
WITHIN_S = 5.0
MAX_BYTES = 1024 * 1024
"""The most bytes of a report; 255 lines are half of it."""
_log = structlog.get_logger()


class PeerError(LinesideError):
    """Raised if a peer cannot be read; the reason does not contain the peer's text."""


class PeerAwayError(PeerError):
    """Raised if there is no connection to a peer now."""


async def follow(peer: Peer, settings: PeerSettings, board: LineBoard) -> None:
    """Read a peer until canceled. The files of its token and its authority are read again after a refusal."""
    while True:
        try:
            async with _client(settings) as client:
                while True:
                    await _read_onto(board, peer, settings, client)
                    await asyncio.sleep(EVERY_S)
        except PeerError as error:
            _note(peer, error.message)
        await asyncio.sleep(REFUSED_EVERY_S)


async def _read_onto(board: LineBoard, peer: Peer, settings: PeerSettings, client: httpx.AsyncClient) -> None:
    """Read one report. A peer that is away is noted. Raise PeerError for a peer that refuses."""
    try:
        report = await _read(client, settings)
    except PeerAwayError as error:
        _note(peer, error.message)
        return
    before = peer.fault
    if fault := board.put(peer, *report):
        raise PeerError(fault)
    if before is not None:
        _log.info("peer read again", peer=peer.name)


def _note(peer: Peer, fault: Message) -> None:
    if fault != peer.fault:
        _log.warning("peer not read", peer=peer.name, why=str(fault))
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
    """Return a client with the token of the peer. Raise PeerError."""
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
    # No proxy and no password from the environment: they lead out of the plant.
    async with httpx.AsyncClient(
        verify=context, trust_env=False, timeout=WITHIN_S, limits=limits, headers=headers
    ) as client:
        yield client


async def _read(
    client: httpx.AsyncClient, settings: PeerSettings
) -> tuple[Mapping[str, LineSummary], str, str]:
    """Return the lines of a peer, its instance and its time. Raise PeerError."""
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
    """Return the body as it came: compressed content could unpack to any size."""
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
