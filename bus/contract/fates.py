"""How far a command is and what became of it: from the worker to the app."""

from __future__ import annotations

from typing import Literal

from msgspec import field

from bus.contract.message import Message, Outcome, Stage
from bus.contract.readings import Frame, ParameterValue


class Progress(Message, frozen=True, tag="progress"):
    """How far a command has come. ``done``/``of`` count rows or addresses where there are several."""

    id: str
    at: float
    stage: Stage
    unit: int | None = None
    done: int = 0
    of: int = 0


class UnitOutcome(Message, frozen=True, tag="unit_outcome"):
    """The fate of a command at one unit, with the times of its frames."""

    unit: int
    outcome: Outcome
    message: str = ""
    unit_error: int | None = None
    read_back: int | None = None
    sent_at: float | None = None
    acknowledged_at: float | None = None
    proven_at: float | None = None
    attempts: int = 0


class FoundUnit(Message, frozen=True, tag="found_unit"):
    """What a scan saw at one address. ``kind``: digimax, garbled (two units?), foreign, or late where
    responses come too late to be told apart."""

    unit: int
    baud: int
    kind: Literal["digimax", "garbled", "foreign", "late"]
    parameters: list[int] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


class Result(Message, frozen=True, tag="result"):
    """The one fate of a command. ``values``: what ReadParameters read. ``skew_s``: upper bound of the
    time between the first and the last unit's acting on one broadcast. ``frames``: what carried it."""

    id: str
    at: float
    outcome: Outcome
    message: str = ""
    unit_error: int | None = None
    read_back: int | None = None
    units: list[UnitOutcome] = field(default_factory=list)
    values: list[ParameterValue] = field(default_factory=list)
    found: list[FoundUnit] = field(default_factory=list)
    skew_s: float | None = None
    frames: list[Frame] = field(default_factory=list)
