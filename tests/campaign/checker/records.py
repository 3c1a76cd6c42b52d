"""The logs of a campaign, as its recorders write them: one JSON object a line, times in Unix time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.campaign.checker.frames import Piece

WIRE, CONNECTIONS, CLIENTS, FAULTS = (
    "wire-{bus}.jsonl",
    "connections-{bus}.jsonl",
    "clients.jsonl",
    "faults.jsonl",
)


@dataclass(frozen=True)
class SentCommand:
    """A speed that a client requested, and the response that it got; ``outcome`` None: it got none.

    ``raw`` is given once to a unit, so that a frame on the wire names its command.
    """

    sent_at: float
    responded_at: float
    bus: str
    unit: int
    raw: int
    timeout_s: float
    outcome: str | None
    reason: str = ""

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
class LiveValue:
    """A value that a server showed as live: when it was shown, and when it was read."""

    at: float
    read_at: float
    bus: str
    server: str


@dataclass(frozen=True)
class HolderDeath:
    """The home of a bus died, and with it everything on its machine; another could take over."""

    at: float
    bus: str
    server: str


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
    live: list[LiveValue]
    deaths: list[HolderDeath]
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
        [LiveValue(**_without_kind(row)) for row in clients if row["kind"] == "live"],
        [
            HolderDeath(row["at"], bus, row["server"])
            for row in lines(folder / FAULTS)
            if row["kind"] == "holder_death" and row["bus"] == bus
        ],
        [(row["begin"], row["end"]) for row in lines(folder / FAULTS) if row["kind"] == "device_halt"],
    )


def _piece(row: dict[str, Any]) -> Piece:
    return Piece(row["at"], bytes.fromhex(row["data"]))


def _without_kind(row: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key != "kind"}


def _journal(row: dict[str, Any]) -> JournalRow:
    return JournalRow(row["alarm"], row["occurrence"], row["trigger"], row["after"])
