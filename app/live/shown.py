"""What the API's answers about the line hold, for its OpenAPI document. A field never read is null."""

from __future__ import annotations

from typing import Any

from typing_extensions import TypedDict

from bus.contract import BusLinkState, UnitLinkState


class InputsShown(TypedDict):
    """The seven inputs; ``estop`` true: an emergency stop is active."""

    run: bool
    estop: bool
    preset: bool
    reverse: bool
    up: bool
    down: bool
    slave: bool


class CauseShown(TypedDict):
    """The first broken rung of e-stop, run, mode, link, ramp. ``since_exact`` false: first seen then."""

    code: str
    params: dict[str, Any]
    detail: str
    since: str | None
    since_exact: bool | None


class UnitShown(TypedDict):
    """One unit. Speeds are decimal texts in the unit's own decimals, ``…_raw`` the integers on the wire."""

    id: int
    name: str
    group: str
    labels: dict[str, Any]
    link: UnitLinkState
    link_cause: str
    cause: CauseShown | None
    blocked: str | None
    suspect: str | None
    read_at: str | None
    age_ms: int | None
    commanded_raw: int | None
    actual_raw: int | None
    deviation_raw: int | None
    commanded: str | None
    actual: str | None
    deviation: str | None
    decimals: int | None
    rpm: float | None
    at_speed_window_raw: int | None
    analog_raw: int | None
    analog: float | None
    at_speed: bool | None
    remote: bool | None
    mode: str | None
    outputs: list[bool] | None
    inputs: InputsShown | None
    follower: bool | None
    staged_raw: int | None
    staged: str | None


class BusShown(TypedDict):
    """One bus. Its figures are null while no worker measures them."""

    name: str
    port: str
    baud: int
    link: BusLinkState
    link_cause: str
    link_since: str
    worker: bool
    scan_hz: float | None
    scan_s: float | None
    scan_s_with_one_more: float | None
    scan_s_expected: float
    wire_utilisation: float | None
    diagnosis: str
    units: list[UnitShown]


class LineShown(TypedDict):
    """Every bus with its units in floor order."""

    site: str
    time: str
    history: str
    buses: list[BusShown]


class ParameterShown(TypedDict):
    """One of the 40. ``available`` null: not read yet; false: this unit does not have it."""

    number: int
    name: str
    raw: int | None
    value: str | None
    unit: str
    min: int
    max: int
    read_at: str | None
    available: bool | None
    type: str
    group: str
    meaning: str
    evidence: str
    choices: dict[str, str]
    writable: bool
    dangerous: str
    masked: bool
