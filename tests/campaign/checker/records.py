"""The logs of a campaign, as its recorders write them: one JSON object a line, times in Unix time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.campaign.checker.frames import Piece

WIRE, CONNECTIONS, KEYPADS = "wire-{bus}.jsonl", "connections-{bus}.jsonl", "keypads-{bus}.jsonl"
CLIENTS, FAULTS = "clients.jsonl", "faults.jsonl"


def digits(raw: int) -> int:
    """``raw`` without its final zeros: what a typed number has in common with the raw of every scale."""
    while raw and raw % 10 == 0:
        raw //= 10
    return raw


NOTHING_SENT = {"not_sent", "bus_closed", "refused_here"}


@dataclass(frozen=True)
class SentCommand:
    """A speed or ratio that a client requested, and the response that it got; ``outcome`` None: it got none.

    ``digits`` are given once to a unit, so that a frame on the wire names its command in whatever scale.
    ``typed``: the number in display units; None: it was given raw.
    """

    sent_at: float
    responded_at: float
    bus: str
    unit: int
    digits: int
    typed: str | None
    timeout_s: float
    outcome: str | None
    unit_error: int | None = None
    reason: str = ""

    @property
    def name(self) -> str:
        """How a violation names it."""
        return f"unit {self.unit} = {self.typed or self.digits}"

    @property
    def is_unsent(self) -> bool:
        """Whether its outcome states that nothing was sent; ``refused_here``: any refusal before sending."""
        refused_by_unit = self.unit_error is not None
        return self.outcome in NOTHING_SENT or (self.outcome == "refused" and not refused_by_unit)

    @property
    def deadline(self) -> float:
        return self.sent_at + self.timeout_s


@dataclass(frozen=True)
class JournalRow:
    """A transition of an alarm, as a client was shown it or as the database holds it."""

    alarm: str
    occurrence: int
    trigger: str
    after: str


@dataclass(frozen=True)
class ShownValue:
    """What the server showed of a unit at a time, and when it had read that by its own statement."""

    at: float
    read_at: float
    unit: int
    link: str
    raw: tuple[int, int, int]
    """Commanded and actual speed, analog input."""
    texts: tuple[str | None, str | None]
    """The two speeds in display units."""


@dataclass(frozen=True)
class StoredValue:
    """What the history has of a value of a unit, in display units."""

    unit: int
    value: str
    numbers: tuple[float, ...]


@dataclass(frozen=True)
class KeypadChange:
    """A parameter of a unit was changed between two moments."""

    unit: int
    number: int
    raw: int
    began: float
    ended: float


@dataclass(frozen=True)
class Records:
    """Everything that was recorded of one bus."""

    bus: str
    requests: list[Piece]
    responses: list[Piece]
    connections: dict[str, list[Piece]]
    commands: list[SentCommand]
    acknowledged: list[JournalRow]
    shown: list[JournalRow]
    values: list[ShownValue]
    stored: list[StoredValue]
    keypads: list[KeypadChange]
    faults: list[tuple[float, float]]
    """Begin and end of each."""
    halts: list[tuple[float, float]]
    """When the device server was halted: begin and end."""


def lines(path: Path) -> Iterator[dict[str, Any]]:
    """The objects of a log; a last line that a kill cut short is left out."""
    if not path.exists():
        return
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            continue


def read(folder: Path, bus: str) -> Records:
    """The logs of ``folder`` that concern ``bus``."""
    wire = list(lines(folder / WIRE.format(bus=bus)))
    connections: dict[str, list[Piece]] = {}
    for row in lines(folder / CONNECTIONS.format(bus=bus)):
        connections.setdefault(row["peer"], []).append(_piece(row))
    clients = [row for row in lines(folder / CLIENTS) if row.get("bus", bus) == bus]
    return Records(
        bus,
        [_piece(row) for row in wire if row["direction"] == "request"],
        [_piece(row) for row in wire if row["direction"] == "response"],
        connections,
        [SentCommand(**_without_kind(row)) for row in clients if row["kind"] == "command"],
        [_journal(row) for row in clients if row["kind"] == "acknowledged"],
        [_journal(row) for row in clients if row["kind"] == "transition"],
        [value for row in clients if row["kind"] == "live" for value in _values(row)],
        [
            StoredValue(row["unit"], row["value"], tuple(row["numbers"]))
            for row in clients
            if row["kind"] == "stored"
        ],
        [
            KeypadChange(*(row[name] for name in ("unit", "number", "raw", "began", "ended")))
            for row in lines(folder / KEYPADS.format(bus=bus))
        ],
        [(row["began"], row["ended"]) for row in lines(folder / FAULTS) if row["kind"] == "fault"],
        [(row["begin"], row["end"]) for row in lines(folder / FAULTS) if row["kind"] == "device_halt"],
    )


def _values(row: dict[str, Any]) -> Iterator[ShownValue]:
    for unit in row["units"]:
        read_at = row["at"] - unit["age_ms"] / 1000
        yield ShownValue(
            row["at"], read_at, unit["id"], unit["link"], tuple(unit["raw"]), tuple(unit["texts"])
        )


def _piece(row: dict[str, Any]) -> Piece:
    return Piece(row["at"], bytes.fromhex(row["data"]))


def _without_kind(row: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key != "kind"}


def _journal(row: dict[str, Any]) -> JournalRow:
    return JournalRow(row["alarm"], row["occurrence"], row["trigger"], row["after"])
