"""``lineside scan``: which addresses respond, at which baud, what they are. It reads only."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from app.cli.ending import ending
from bus.line.scan.found import Found, conclude, settings_seen
from bus.line.scan.passes import PASSES, no_response_s
from bus.line.scan.scanner import BaudScan, scan_baud
from bus.messages import Message
from bus.settings import BAUDS, check_port

FASTEST_FIRST: tuple[int, ...] = tuple(sorted(BAUDS, reverse=True))
"""9600 is the default of a unit, and the quickest to try."""
INTERRUPTED = 130
"""As a shell reports a program that SIGINT ended."""
_SOCKET = "socket://"
_KINDS = {"digimax": "DIGIMAX IV", "garbled": "garbled", "foreign": "no DIGIMAX IV"}


def register(cli: typer.Typer) -> None:
    """Add the command."""
    cli.command()(scan)


def scan(
    port: Annotated[str, typer.Option(help="A device path, socket://host:port or rfc2217://host:port.")],
    baud: Annotated[
        int | None,
        typer.Option(help="Only this baud rate; else all six, fastest first, until a unit responds."),
    ] = None,
    first: Annotated[int, typer.Option(min=1, max=255, help="The first address to poll.")] = 1,
    last: Annotated[int, typer.Option(min=1, max=255, help="The last address to poll.")] = 255,
    turnaround_ms: Annotated[
        float, typer.Option(min=0, max=5000, help="Milliseconds that a unit may take to start its response.")
    ] = 50.0,
    every_baud: Annotated[
        bool, typer.Option("--every-baud", help="Scan at all six baud rates, even after a response.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="The result as JSON.")] = False,
) -> None:
    """Poll every address, twice without a response; nothing is written to any unit.

    Exit 0 when a unit responded, 1 when none did, 130 when interrupted by Ctrl-C.
    """
    try:
        check_port(port)
    except ValueError as error:
        raise typer.BadParameter(f"{port!r}: {error}", param_hint="--port") from error
    if baud is not None and baud not in BAUDS:
        raise typer.BadParameter(f"{baud} is none of {', '.join(map(str, BAUDS))}", param_hint="--baud")
    if first > last:
        raise typer.BadParameter(f"{first} is above --last {last}", param_hint="--first")
    bauds = bauds_to_try(port, baud)
    addresses = range(first, last + 1)
    typer.echo(announcement(port, bauds, addresses, turnaround_ms / 1000, every_baud), err=True)
    scans: list[BaudScan] = []
    failure, code = "", 0
    try:
        with ending():
            asyncio.run(_scan(scans, port, bauds, addresses, turnaround_ms / 1000, every_baud))
    except typer.Exit:
        if not any(done.found for done in scans):
            raise
        failure, code = "the port was lost", 1
    except KeyboardInterrupt:
        failure, code = "interrupted", INTERRUPTED
    found = [one for done in scans for one in done.found]
    _report(port, scans, found, as_json, turnaround_ms, complete=not failure)
    if failure:
        typer.echo(f"lineside: {failure}: the scan is not complete, this is what was found so far.", err=True)
        raise typer.Exit(code)
    if not found:
        tried = ", ".join(str(done.baud) for done in scans)
        typer.echo(
            f"lineside: no unit responded at {tried} baud; look at the wiring, at #17 and #18 of the units, "
            "or allow them longer with --turnaround-ms.",
            err=True,
        )
        raise typer.Exit(1)


def bauds_to_try(port: str, baud: int | None) -> tuple[int, ...]:
    """A device server sets its baud rate itself: 9600 is assumed for its pace."""
    if baud is not None:
        return (baud,)
    return (9600,) if port.startswith(_SOCKET) else FASTEST_FIRST


def announcement(
    port: str, bauds: Sequence[int], addresses: range, turnaround_s: float, every_baud: bool
) -> str:
    """What will be done and how long it takes, before it is done."""
    seconds = [PASSES * len(addresses) * no_response_s(baud, turnaround_s) for baud in bauds]
    which = (
        f"addresses {addresses[0]} to {addresses[-1]}" if len(addresses) > 1 else f"address {addresses[0]}"
    )
    if len(bauds) == 1:
        how_long = f"{bauds[0]} baud: about {_duration(seconds[0])}"
    elif every_baud:
        how_long = f"all six baud rates: about {_duration(sum(seconds))}"
    else:
        how_long = (
            f"{bauds[0]} baud, about {_duration(seconds[0])}, then the slower ones until a unit responds: "
            f"{_duration(sum(seconds))} at most"
        )
    return f"Scanning {port}, {which}, at {how_long}; each unit found adds up to 2 s. Ctrl-C ends it."


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{max(rest, 1)} s"


async def _scan(
    scans: list[BaudScan],
    port: str,
    bauds: Sequence[int],
    addresses: range,
    turnaround_s: float,
    every_baud: bool,
) -> None:
    for baud in bauds:
        scans.append(BaudScan(baud, turnaround_s))
        length = PASSES * len(addresses)
        with typer.progressbar(length=length, label=f"{baud:>5} baud", file=sys.stderr) as bar:
            await scan_baud(scans[-1], port, addresses, bar.update)
        if scans[-1].found and not every_baud:
            break


def _report(
    port: str,
    scans: Sequence[BaudScan],
    found: Sequence[Found],
    as_json: bool,
    turnaround_ms: float,
    *,
    complete: bool,
) -> None:
    remarks = conclude(found)
    if any(done.echoes for done in scans):
        remarks.append(Message("scan_echo"))
    allowed_ms = max(round(1000 * done.turnaround_s) for done in scans)
    if allowed_ms > turnaround_ms:
        remarks.append(Message.of("scan_turnaround", value=allowed_ms))
    if as_json:
        settings = {**settings_seen(found), "turnaround_ms": allowed_ms}
        document = _json(port, scans, found, [str(remark) for remark in remarks])
        typer.echo(json.dumps({**document, "settings": settings, "complete": complete}))
        return
    for one in found:
        typer.echo(_line(one))
        for remark in one.remarks:
            typer.echo(f"    {remark}")
    for remark in remarks:
        typer.echo(str(remark))


def _line(one: Found) -> str:
    words = [f"unit {one.unit} at {one.baud} baud: {_KINDS[one.kind]}"]
    if one.parameters:
        words.append(f"parameters 1 to {one.parameters[-1]}")
    if one.remote is not None:
        words.append("remote" if one.remote else "not remote: it refuses every write")
    if one.answered_within_s is not None:
        words.append(f"responds within {1000 * one.answered_within_s:.1f} ms")
    return ", ".join(words)


def _json(port: str, scans: Sequence[BaudScan], found: Sequence[Found], remarks: list[str]) -> dict[str, Any]:
    return {
        "port": port,
        "bauds": [{"baud": done.baud, "seconds": round(done.seconds, 3)} for done in scans],
        "units": [_unit_json(one) for one in found],
        "remarks": remarks,
    }


def _unit_json(one: Found) -> dict[str, Any]:
    answered = one.answered_within_s
    return {
        "id": one.unit,
        "baud": one.baud,
        "kind": one.kind,
        "remote": one.remote,
        "parameters": list(one.parameters),
        "own_address": one.own_address,
        "parameter_numbers": "bcd" if one.counts_in_bcd else "binary",
        "checksum_10h": one.checksum_10h,
        "parameter_reply_bytes": list(one.reply_bytes),
        "estop_healthy": one.estop_healthy,
        "turnaround_ms": None if answered is None else round(1000 * answered, 1),
        "remarks": [str(remark) for remark in one.remarks],
    }
