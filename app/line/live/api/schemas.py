"""Members of the API's responses about the line, for its OpenAPI document. A field never read is null."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import TypeAliasType, TypedDict

from app.core.web.shape import Instant, MaybeInstant, MessageShown
from app.line.conditions.condition import DrawState
from bus.contract import BusLinkState, UnitLinkState

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
    """Names of the wiring of a unit, from lineside.toml; empty or left out where none is given."""

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
    """One unit. Speeds are decimal texts in its own decimals (#3), ``…_raw`` the integers on the wire."""

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
    """What the wire of a bus carries; null while no worker measures it."""

    scan_hz: Annotated[float | None, Field(description="Scans per second.")]
    scan_s: Annotated[
        float | None, Field(description="Duration of one scan, seconds; null while no unit responds.")
    ]
    scan_s_with_one_more: Annotated[float | None, Field(description="The same with one unit more, seconds.")]
    wire_utilisation: Annotated[float | None, Field(description="Share of the wire's time in use, 0 to 1.")]
    diagnosis: Annotated[list[MessageShown], Field(description="Likely causes of faults on the bus.")]


class BusShown(WireShown):
    """One bus. Figures are null while no worker measures them."""

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
    """Every bus with its units in floor order."""

    site: str
    time: Time
    history: Annotated[MessageShown | None, Field(description="Why no history is stored; null while it is.")]
    buses: list[BusShown]


EventCount = Annotated[int, Field(description="Since the bus worker started.")]
ResponseSeconds = Annotated[float | None, Field(description="Seconds; null: no response yet.")]


class NakCount(TypedDict):
    """How often a unit refused with one error."""

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
    """One of the 40 parameters of a unit as last read."""

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
