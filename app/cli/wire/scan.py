"""``lineside scan``: which addresses respond, at which baud, what they are. It reads only."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import click

from app.cli.ending import complain, ending, report, wrong_option
from app.cli.options import AsJson, Option
from app.cli.wire.bus_table import bus_table
from app.web.api.shape import message_shown
from bus.line.scan.found import Found, conclude, settings_seen
from bus.line.scan.passes import PASSES, no_response_s
from bus.line.scan.scanner import BaudScan, scan_baud
from bus.messages import Message, listed, number
from bus.settings import BAUDS, check_port
from bus.text import without_credentials

FASTEST_FIRST: tuple[int, ...] = tuple(sorted(BAUDS, reverse=True))
"""9600 is the default of a unit, and the quickest to try."""
INTERRUPTED = 130
"""As a shell reports a program that SIGINT ended."""
_SOCKET = "socket://"
_KINDS = {"digimax": "found_digimax", "garbled": "found_kind_garbled", "foreign": "found_kind_foreign"}


def scan(
    port: Annotated[str, Option(help="A device path, socket://host:port or rfc2217://host:port.")],
    baud: Annotated[
        int | None,
        Option(help="Only this baud rate; else all six, fastest first, until a unit responds."),
    ] = None,
    first: Annotated[int, Option(min=1, max=255, help="The first address to poll.")] = 1,
    last: Annotated[int, Option(min=1, max=255, help="The last address to poll.")] = 255,
    turnaround_ms: Annotated[
        float, Option(min=0, max=5000, help="Milliseconds that a unit may take to start its response.")
    ] = 50.0,
    every_baud: Annotated[
        bool, Option("--every-baud", help="Scan at all six baud rates, even after a response.")
    ] = False,
    as_json: AsJson = False,
    as_toml: Annotated[
        bool, Option("--toml", help="The result as a [[bus]] to paste into lineside.toml.")
    ] = False,
) -> None:
    """Poll every address, twice without a response; nothing is written to any unit.

    Exit 0 when a unit responded, 1 when none did, 130 when interrupted by Ctrl-C.
    """
    _refuse_wrong_use(port, baud, first, last, as_json and as_toml)
    bauds = bauds_to_try(port, baud)
    addresses = range(first, last + 1)
    report(announcement(port, bauds, addresses, turnaround_ms / 1000, every_baud), err=True)
    scans: list[BaudScan] = []
    failure: Message | None = None
    code = 0
    try:
        with ending():
            asyncio.run(scan_bauds(scans, port, bauds, addresses, turnaround_ms / 1000, every_baud))
    except click.exceptions.Exit:
        if not any(done.found for done in scans):
            raise
        failure, code = Message("scan_port_lost"), 1
    except KeyboardInterrupt:
        failure, code = Message("scan_interrupted"), INTERRUPTED
    if as_toml:
        click.echo(bus_table(port, units_of(scans), allowed_ms(scans)), nl=False)
    else:
        _report(port, scans, as_json, turnaround_ms, complete=failure is None)
    if failure is not None:
        complain(failure)
        raise click.exceptions.Exit(code)
    if not any(done.found for done in scans):
        complain(Message.of("scan_no_response", bauds=[done.baud for done in scans]))
        raise click.exceptions.Exit(1)


def _refuse_wrong_use(port: str, baud: int | None, first: int, last: int, is_twofold: bool) -> None:
    try:
        check_port(port)
    except ValueError as error:
        raise wrong_option(
            "--port", "option_port_refused", port=without_credentials(repr(port)), reason=error.args[0]
        ) from error
    if baud is not None and baud not in BAUDS:
        raise wrong_option("--baud", "option_none_of", value=baud, known=list(BAUDS))
    if is_twofold:
        raise wrong_option("--toml", "option_not_both", other="--json")
    if first > last:
        raise wrong_option("--first", "option_first_above_last", first=first, last=last)


def bauds_to_try(port: str, baud: int | None) -> tuple[int, ...]:
    """A device server sets its baud rate itself: 9600 is assumed for its pace."""
    if baud is not None:
        return (baud,)
    return (9600,) if port.startswith(_SOCKET) else FASTEST_FIRST


def announcement(
    port: str, bauds: Sequence[int], addresses: range, turnaround_s: float, every_baud: bool
) -> Message:
    """What will be done and how long it takes, before it is done."""
    seconds = [PASSES * len(addresses) * no_response_s(baud, turnaround_s) for baud in bauds]
    which = Message.of(
        "scan_addresses" if len(addresses) > 1 else "scan_address", first=addresses[0], last=addresses[-1]
    )
    one, all_of_them = _duration(seconds[0]), _duration(sum(seconds))
    if len(bauds) == 1:
        how_long = Message.of("scan_one_baud", baud=bauds[0], time=one)
    elif every_baud:
        how_long = Message.of("scan_all_bauds", time=all_of_them)
    else:
        how_long = Message.of("scan_slower_bauds", baud=bauds[0], time=one, most=all_of_them)
    return Message.of("scan_begins", port=port, which=which, how_long=how_long)


def _duration(seconds: float) -> Message:
    minutes, rest = divmod(round(seconds), 60)
    if minutes:
        return Message.of("duration_minutes", minutes=minutes, seconds=rest)
    return Message.of("duration_seconds", seconds=max(rest, 1))


async def scan_bauds(
    scans: list[BaudScan],
    port: str,
    bauds: Sequence[int],
    addresses: range,
    turnaround_s: float,
    every_baud: bool,
) -> None:
    """Scan at one baud rate after another, by default until one has a unit; each adds to ``scans`` as it
    begins, so that an early end leaves what was found. Raises WireError."""
    for baud in bauds:
        scans.append(BaudScan(baud, turnaround_s))
        length = PASSES * len(addresses)
        with click.progressbar(length=length, label=f"{baud:>5} baud", file=sys.stderr) as bar:
            await scan_baud(scans[-1], port, addresses, bar.update)
        if scans[-1].found and not every_baud:
            break


def units_of(scans: Sequence[BaudScan]) -> list[Found]:
    """What responded, in the order of the scan."""
    return [one for done in scans for one in done.found]


def allowed_ms(scans: Sequence[BaudScan]) -> int:
    """What units were allowed to take in the end."""
    return max(round(1000 * done.turnaround_s) for done in scans)


def _report(
    port: str, scans: Sequence[BaudScan], as_json: bool, turnaround_ms: float, *, complete: bool
) -> None:
    found = units_of(scans)
    remarks = conclude(found)
    if any(done.echoes for done in scans):
        remarks.append(Message("scan_echo"))
    needed_ms = allowed_ms(scans)
    if needed_ms > turnaround_ms:
        remarks.append(Message.of("scan_turnaround", value=needed_ms))
    if as_json:
        document = {
            "port": port,
            "bauds": [{"baud": done.baud, "seconds": round(done.seconds, 3)} for done in scans],
            "units": [_unit_json(one) for one in found],
            **_remarks(remarks),
            "settings": {**settings_seen(found), "turnaround_ms": needed_ms},
            "complete": complete,
        }
        click.echo(json.dumps(document))
        return
    for one in found:
        report(_line(one))
        for remark in one.remarks:
            click.echo(f"    {remark}")
    for remark in remarks:
        report(remark)


def _line(one: Found) -> Message:
    traits = [Message(_KINDS[one.kind])]
    if one.parameters:
        traits.append(Message.of("found_parameters_to", last=one.parameters[-1]))
    if one.remote is not None:
        traits.append(Message("found_remote" if one.remote else "found_not_remote"))
    if one.responds_within_s is not None:
        traits.append(Message.of("found_responds_within", time=number(f"{1000 * one.responds_within_s:.1f}")))
    return Message.of("unit_found", unit=one.unit, baud=one.baud, traits=listed(traits))


def _unit_json(one: Found) -> dict[str, Any]:
    responded = one.responds_within_s
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
        "turnaround_ms": None if responded is None else round(1000 * responded, 1),
        **_remarks(one.remarks),
    }


def _remarks(remarks: Sequence[Message]) -> dict[str, Any]:
    return {
        "remarks": [str(remark) for remark in remarks],
        "remark_messages": [message_shown(remark) for remark in remarks],
    }
