"""A unit, a bus and the line as the API shows them, with the schemas of its OpenAPI document. Pure: the time
is passed in.

Speeds are decimal texts in the unit's own decimals (#3), null while those are not known; a field that was
never read is null. ``…_raw`` are the integers on the wire.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from msgspec.structs import asdict
from pydantic import Field
from typing_extensions import TypeAliasType, TypedDict

from app.core.web.shape import Instant, MaybeInstant, MessageShown, iso, maybe_shown, message_shown
from app.line.conditions.condition import DRAW_DECIMALS, DrawState
from app.line.conditions.unit import suspicion
from app.line.live.bus_live import (
    BusLive,
    LiveState,
    UnitLive,
    bits_of,
    draw_of,
    follower,
    mode_of,
    scan_s_of,
    setpoint_decimals,
    speed_decimals,
    unit_link_now,
)
from app.line.live.diagnosis import Cause, unit_cause
from app.line.live.fields import Translator, cause_texts
from app.line.live.sources import Sources
from bus.catalogue.parameters import (
    ANALOG_IN_HIGH,
    ANALOG_IN_LOW,
    AT_SPEED_WINDOW,
    DECIMALS,
    MAX_DISPLAY,
    MAX_RPM,
    PARAMETERS,
)
from bus.catalogue.values import (
    analog_input_value,
    parameter_text,
    parameter_unit,
    plausible_parameter,
    rpm,
    speed_text,
)
from bus.contract import BusFigures, BusLinkState, Reading, UnitFigures, UnitLinkState
from bus.errors import unit_error_name
from bus.instants import UnixTime
from bus.messages import Message

Json = dict[str, Any]

_NEVER_READ = dict.fromkeys(
    (
        *("read_at", "age_ms", "commanded_raw", "actual_raw", "deviation_raw"),
        *("commanded", "actual", "deviation", "rpm", "analog_raw", "analog"),
        *("at_speed", "remote", "mode", "outputs", "inputs", "implausible"),
    )
)
_NOT_MEASURED: Json = {
    **dict.fromkeys(("scan_hz", "scan_s", "scan_s_with_one_more", "wire_utilisation")),
    "diagnosis": [],
}


@dataclass(frozen=True, slots=True)
class LineView:
    """The line with its texts in English. Times are Unix times in seconds."""

    site: str
    live: LiveState
    sources: Sources
    english: Translator

    def line(self, now: UnixTime, only: str | None = None) -> Json:
        """Return every bus, or ``only`` one, with its units in floor order."""
        return {
            "site": self.site,
            "time": iso(now),
            "history": maybe_shown(self.sources.history_fault()),
            "buses": [self.bus(name, now) for name in self.live.buses if only in (None, name)],
        }

    def bus(self, name: str, now: UnixTime) -> Json:
        """Return one bus with its units."""
        bus = self.live.buses[name]
        return bus_fields(bus) | {"units": [self.unit(name, unit, now) for unit in bus.units]}

    def unit(self, name: str, number: int, now: UnixTime) -> Json:
        """Return one unit of a bus, with the age of its reading by the server's clock."""
        bus = self.live.buses[name]
        unit = bus.units[number]
        draw = draw_of(bus, unit, now)
        shown: Json = {
            "id": number,
            "name": unit.settings.name,
            "group": unit.settings.group,
            "labels": unit.settings.labels.model_dump(),
            "link": unit_link_now(bus, unit, now),
            "link_cause": maybe_shown(unit.link.cause),
            "cause": cause_json(unit_cause(bus, unit, now), now, self.english),
            "suspect": maybe_shown(suspicion(bus, unit)),
            "blocked": maybe_shown(self.sources.guards[name].block_reason(number)),
            "decimals": unit.parameter_raw(DECIMALS),
            "follower": follower(unit),
            "scale_current": not unit.scale_is_old,
            "staged_raw": unit.staged,
            "staged_unknown": unit.staged_unknown,
            "staged": None if unit.staged is None else setpoint_text(unit, unit.staged),
            "draw": None if draw.tenths is None else _signed_text(draw.tenths, DRAW_DECIMALS),
            "draw_state": "none" if draw.state == "ramping" else draw.state,
            "at_speed_window_raw": unit.parameter_raw(AT_SPEED_WINDOW),
        }
        return shown | (_NEVER_READ if unit.reading is None else _reading_json(bus, unit, unit.reading, now))


def bus_fields(bus: BusLive) -> Json:
    """Return one bus without its units."""
    return wire_json(bus.figures) | {
        "name": bus.settings.name,
        "port": bus.settings.port,
        "baud": bus.baud,
        "link": bus.link.link,
        "link_cause": maybe_shown(bus.link.cause),
        "link_since": iso(bus.link_onset.at),
        "worker": bus.worker_connected,
        "scan_s_expected": scan_s_of(bus),
    }


def wire_json(figures: BusFigures | None) -> Json:
    """Return the measurements of the wire of a bus; null without figures."""
    if figures is None:
        return _NOT_MEASURED
    return {
        "scan_hz": figures.scan_hz,
        "scan_s": figures.scan_s or None,
        "scan_s_with_one_more": figures.scan_s_with_one_more,
        "wire_utilisation": figures.wire_utilisation,
        "diagnosis": [message_shown(each) for each in figures.diagnosis],
    }


_COUNTS = ("noise_bytes", "echoes", "updates_lost", "responds_for_all")


def figures_json(bus: str, figures: BusFigures | None) -> Json:
    """Return the figures of a bus; null if no worker measures them."""
    measured: Json = {name: getattr(figures, name, None) for name in _COUNTS} | wire_json(figures)
    units = [_statistics_json(unit) for unit in figures.units] if figures else []
    at = iso(figures.at) if figures else None
    return measured | {"bus": bus, "measured": figures is not None, "at": at, "units": units}


def _statistics_json(unit: UnitFigures) -> Json:
    naks = [
        {"unit_error": code, "unit_error_name": unit_error_name(code), "count": count}
        for code, count in sorted(unit.naks.items())
    ]
    return asdict(unit) | {"naks": naks}


def cause_json(cause: Cause | None, now: UnixTime, english: Translator) -> Json | None:
    """Return a cause as a code with parameters, in words, and since when; None without a cause."""
    if cause is None:
        return None
    why = cause.params.get("why")
    return {
        "code": cause.code,
        "params": {name: _plain(value) for name, value in cause.params.items()},
        "detail": cause_texts(cause, english, now).line,
        "why": message_shown(why) if isinstance(why, Message) else None,
        "since": None if cause.onset is None else iso(cause.onset.at),
        "since_exact": None if cause.onset is None else cause.onset.exact,
    }


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Message) else value


def parameter_json(unit: UnitLive, number: int) -> Json:
    """Return one of the 40 parameters as last read; ``available`` null: not read yet. A secret is masked."""
    parameter = PARAMETERS[number]
    known = unit.parameters.get(number)
    raw = known.raw if known is not None else None
    is_implausible = plausible_parameter(number, raw) != raw
    return {
        "number": number,
        "name": parameter.name,
        "raw": None if parameter.secret else raw,
        "value": None if raw is None or is_implausible else _parameter_text(unit, number, raw),
        "unit": parameter_unit(parameter),
        "min": parameter.minimum,
        "max": parameter.maximum,
        "read_at": None if known is None else iso(known.at),
        "available": None if known is None else known.available,
        "type": parameter.type,
        "group": parameter.group,
        "meaning": parameter.meaning,
        "evidence": parameter.evidence,
        "choices": {str(value): name for value, name in parameter.choices.items()},
        "writable": not parameter.never_writable,
        "dangerous": parameter.dangerous,
        "masked": parameter.secret,
        "implausible": is_implausible,
    }


def setpoint_text(unit: UnitLive, raw: int) -> str | None:
    """Return a setpoint as the unit takes it, for a follower a ratio; None while decimals are unknown."""
    return _speed_text(raw, setpoint_decimals(unit))


def _parameter_text(unit: UnitLive, number: int, raw: int) -> str:
    decimals = unit.parameter_raw(DECIMALS)
    return parameter_text(PARAMETERS[number], raw, decimals, follower=bool(follower(unit)))


def _reading_json(bus: BusLive, unit: UnitLive, reading: Reading, now: UnixTime) -> Json:
    bits = bits_of(bus, reading)
    decimals = speed_decimals(bus, unit)
    error = reading.deviation
    return {
        "read_at": iso(reading.at),
        "age_ms": max(0, round(1000 * (now - reading.at))),
        "commanded_raw": reading.commanded,
        "actual_raw": reading.actual,
        "deviation_raw": error,
        "commanded": _speed_text(reading.commanded, decimals),
        "actual": _speed_text(reading.actual, decimals),
        "deviation": None if decimals is None or error is None else _signed_text(error, decimals),
        "rpm": _rpm(unit, reading.actual),
        "analog_raw": reading.analog,
        "analog": analog_value(unit, reading.analog),
        "at_speed": bits.at_speed,
        "remote": bits.remote,
        "mode": mode_of(unit, bits).upper(),
        "outputs": list(bits.outputs),
        "inputs": bits.inputs,
        "implausible": reading.implausible.hex(" ").upper() or None,
    }


def _speed_text(raw: int | None, decimals: int | None) -> str | None:
    return None if decimals is None or raw is None else speed_text(raw, decimals)


def _signed_text(raw: int, decimals: int) -> str:
    return ("-" if raw < 0 else "") + speed_text(abs(raw), decimals)


def _rpm(unit: UnitLive, raw: int | None) -> float | None:
    max_rpm, max_display = unit.parameter_raw(MAX_RPM), unit.parameter_raw(MAX_DISPLAY)
    if raw is None or max_rpm is None or not max_display:
        return None
    return round(rpm(raw, max_rpm, max_display), 1)


def analog_value(unit: UnitLive, atd: int) -> float | None:
    """Return the value of an analog input in its engineering unit; None while #22 or #23 was not read."""
    low, high = unit.parameter_raw(ANALOG_IN_LOW), unit.parameter_raw(ANALOG_IN_HIGH)
    return None if low is None or high is None else round(analog_input_value(atd, low, high), 6)


Raw = Annotated[int | None, Field(description="Integer on the wire, 0 to 99999; null: not known.")]
DisplayedValue = Annotated[
    str | None, Field(description="Decimal text as the unit displays it; null: not known.")
]
Time = Annotated[
    Instant, Field(description="ISO 8601 in UTC, milliseconds.", examples=["2026-11-21T03:12:00.125+00:00"])
]
MaybeTime = Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds; null: never.")]
UnitAddress = Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")]
UnitDrawState = TypeAliasType("UnitDrawState", DrawState)
MaybeBit = Annotated[bool | None, Field(description="null: not known.")]


class InputsShown(TypedDict):
    """The seven inputs."""

    run: bool
    estop: Annotated[bool, Field(description="Whether an emergency stop is active.")]
    preset: bool
    reverse: bool
    up: bool
    down: bool
    slave: Annotated[bool, Field(description="Whether the unit follows a master.")]


class Labels(TypedDict):
    """The names of a unit's wiring, from lineside.toml; empty or left out if none is given."""

    output: Annotated[dict[int, str], Field(description="By number of the auxiliary output, 1 to 6.")]
    input: Annotated[dict[str, str], Field(description="By name of the input.")]
    analog: str
    analog_unit: str
    unit: Annotated[str, Field(description="What the display shows, for example m/min.")]


class CauseShown(TypedDict):
    """The first broken rung of e-stop, run, mode, link, ramp."""

    code: str
    params: Annotated[dict[str, str | int | float | None], Field(description="What the text names.")]
    detail: str
    why: Annotated[MessageShown | None, Field(description="Its reason as data; null: none is named.")]
    since: MaybeTime
    since_exact: Annotated[bool | None, Field(description="false: first seen then, it may be older.")]


class UnitShown(TypedDict):
    """A unit. Speeds are decimal texts in its own decimals (#3), ``…_raw`` the integers on the wire."""

    id: UnitAddress
    name: str
    group: str
    labels: Labels
    link: Annotated[
        UnitLinkState,
        Field(description="stale: a response is overdue; offline: several missed; unknown: never seen."),
    ]
    link_cause: Annotated[
        MessageShown | None, Field(description="Cause of the state of the link; null while it is online.")
    ]
    cause: Annotated[
        CauseShown | None, Field(description="Why it is not at speed; null: it is, or nothing is known.")
    ]
    blocked: Annotated[
        MessageShown | None, Field(description="Why commands to it are blocked; null: they are not.")
    ]
    suspect: Annotated[
        MessageShown | None, Field(description="Why another unit may respond in its name; null: no sign.")
    ]
    read_at: Annotated[MaybeInstant, Field(description="When the values below were read, ISO 8601 in UTC.")]
    age_ms: Annotated[int | None, Field(description="How old they are by the server's clock, milliseconds.")]
    commanded_raw: Raw
    actual_raw: Raw
    deviation_raw: Annotated[
        int | None, Field(description="actual_raw minus commanded_raw, -99999 to 99999.")
    ]
    commanded: DisplayedValue
    actual: DisplayedValue
    deviation: DisplayedValue
    draw: Annotated[
        str | None,
        Field(description="Actual speed to that of the unit before, in percent of the latter; null: none."),
    ]
    draw_state: Annotated[
        UnitDrawState, Field(description="By draw_percent of lineside.toml; none: nothing is judged.")
    ]
    decimals: Annotated[
        int | None, Field(description="Decimals of the display (#3), 0 to 4; null: not read.")
    ]
    rpm: Annotated[float | None, Field(description="Actual speed, 1/min; null: #1 or #2 not read.")]
    at_speed_window_raw: Annotated[int | None, Field(description="At-speed window ± (#12), display units.")]
    analog_raw: Annotated[int | None, Field(description="Analog input, 0 to 255.")]
    analog: Annotated[float | None, Field(description="Analog input scaled by #22 and #23; null: not known.")]
    at_speed: MaybeBit
    remote: MaybeBit
    mode: Annotated[str | None, Field(description="LOCAL, REMOTE or KEYLOCK; null: not known.")]
    outputs: Annotated[list[bool] | None, Field(description="The six auxiliary outputs, output 1 first.")]
    inputs: InputsShown | None
    follower: Annotated[bool | None, Field(description="Whether #8 makes it follow a master by a ratio.")]
    implausible: Annotated[
        str | None,
        Field(
            description="The data of the response in hexadecimal where a speed is beyond 99999, and so null; "
            "null: none is."
        ),
    ]
    scale_current: Annotated[
        bool,
        Field(description="false: it was away or changed at its keypad; its decimals are being read again."),
    ]
    staged_raw: Annotated[
        int | None, Field(description="Speed staged by 82h and not yet executed, 0 to 99999.")
    ]
    staged_unknown: Annotated[
        bool,
        Field(description="It did not acknowledge 82h, or was away since; what it would execute is unknown."),
    ]
    staged: DisplayedValue


class WireShown(TypedDict):
    """The measurements of the wire of a bus; null while no worker measures it."""

    scan_hz: Annotated[float | None, Field(description="Scans per second.")]
    scan_s: Annotated[
        float | None, Field(description="Duration of one scan, seconds; null while no unit responds.")
    ]
    scan_s_with_one_more: Annotated[float | None, Field(description="The same with one unit more, seconds.")]
    wire_utilisation: Annotated[float | None, Field(description="Share of the wire's time in use, 0 to 1.")]
    diagnosis: Annotated[list[MessageShown], Field(description="Likely causes of faults on the bus.")]


class BusShown(WireShown):
    """A bus. Figures are null while no worker measures them."""

    name: str
    port: str
    baud: Annotated[int, Field(description="Bits per second: 300, 600, 1200, 2400, 4800 or 9600.")]
    link: Annotated[BusLinkState, Field(description="Whether the port is open or closed.")]
    link_cause: Annotated[
        MessageShown | None, Field(description="Why the port is closed; null while it is open.")
    ]
    link_since: Time
    worker: Annotated[bool, Field(description="Whether the bus worker is connected.")]
    scan_s_expected: Annotated[
        float, Field(description="Duration of a scan that the staleness is judged by, seconds.")
    ]
    units: Annotated[list[UnitShown], Field(description="In floor order.")]


class Line(TypedDict):
    """The buses with their units in floor order."""

    site: str
    time: Time
    history: Annotated[MessageShown | None, Field(description="Why no history is stored; null while it is.")]
    buses: list[BusShown]


EventCount = Annotated[int, Field(description="Since the bus worker started.")]
ResponseSeconds = Annotated[float | None, Field(description="Seconds; null: no response yet.")]


class NakCount(TypedDict):
    """The number of refusals of a unit with one error."""

    unit_error: Annotated[int, Field(description="Error code of the NAK, 128 to 137.")]
    unit_error_name: str
    count: EventCount


class UnitStatisticsShown(TypedDict):
    """The counters and response times of one unit."""

    unit: Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")]
    polls: EventCount
    responses: Annotated[int, Field(description="Responses since the bus worker started.")]
    timeouts: EventCount
    retries: EventCount
    checksum_errors: EventCount
    foreign: Annotated[
        int, Field(description="Responses that are not of a DIGIMAX IV, since the worker started.")
    ]
    late: Annotated[
        int, Field(description="Responses after their window, or twice, since the worker started.")
    ]
    naks: list[NakCount]
    response_s_min: ResponseSeconds
    response_s_median: ResponseSeconds
    response_s_p99: ResponseSeconds
    response_s_max: ResponseSeconds


class BusStatistics(WireShown):
    """The figures of a bus, measured about once a second; null while no worker measures."""

    bus: str
    measured: Annotated[bool, Field(description="Whether a worker measures; without one all else is null.")]
    at: Annotated[MaybeInstant, Field(description="ISO 8601 in UTC, milliseconds.")]
    noise_bytes: Annotated[
        int | None, Field(description="Bytes that are no frame, since the worker started.")
    ]
    echoes: Annotated[int | None, Field(description="Own requests received back, since the worker started.")]
    updates_lost: Annotated[
        int | None, Field(description="Readings dropped because the dashboard was away for too long.")
    ]
    responds_for_all: Annotated[
        int | None, Field(description="Unit that seems to respond to every address, 1 to 255; 0: none.")
    ]
    units: list[UnitStatisticsShown]


class ParameterShown(TypedDict):
    """A parameter (of 40) of a unit as last read."""

    number: Annotated[int, Field(description="1 to 40.")]
    name: str
    raw: Annotated[int | None, Field(description="Integer on the wire; null: not read, or masked.")]
    value: Annotated[str | None, Field(description="As shown to people; null: not known.")]
    unit: Annotated[str, Field(description="Unit of measurement of value; empty: none.")]
    min: Annotated[int, Field(description="Lowest raw value.")]
    max: Annotated[int, Field(description="Highest raw value.")]
    read_at: MaybeTime
    available: Annotated[
        bool | None, Field(description="null: not read yet; false: the unit does not have it.")
    ]
    type: str
    group: str
    meaning: str
    evidence: Annotated[
        str, Field(description="A stated in the manual, B in a sibling's, C inferred, U unknown.")
    ]
    choices: Annotated[
        dict[str, str], Field(description="Names of the values of an enumeration, by raw value.")
    ]
    writable: bool
    dangerous: Annotated[str, Field(description="Risk of the write; empty: it needs no confirmation.")]
    masked: Annotated[bool, Field(description="Whether it is a secret (#21).")]
    implausible: Annotated[
        bool,
        Field(description="Whether raw is outside of min and max: value is null, and it scales nothing."),
    ]
