"""The commands ``lineside scan`` (the addresses that respond, their baud rates, their kinds), ``lineside
decode`` (the meaning of frames) and ``lineside simulate`` (simulated units at a port). None needs a site, and
none writes to a unit."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeVar, get_args

import click

from app.cli.command import ADDRESS, PATH, TCP_PORT, complain, json_option, report, wrong_option
from app.core.web.shape import maybe_shown, message_shown
from app.line.commands.trace_file import is_trace_line, parse_trace_line
from bus.catalogue import parameters as numbers
from bus.configuration import bus_lines
from bus.contract import Frame
from bus.errors import CallerError, LinesideError
from bus.line.examination import PASSES, Found, conclude, no_response_s, settings_seen
from bus.line.scanner import BaudScan, scan_baud
from bus.messages import Message, listed, number
from bus.settings import BAUDS, Dialect, check_port
from bus.simulator.line import Faults, SimulatedLine
from bus.simulator.plant import demo_line
from bus.simulator.ports import Port, PtyPort, TcpLinePort
from bus.simulator.serve import LineServer, control_port
from bus.simulator.unit import Traits
from bus.validation import without_credentials
from bus.wire.describe import Described, DescribedNoise, Describer, describe_bytes
from bus.wire.framing import FrameDecoder

_SEPARATORS = re.compile(r"[\s,;:\[\]]+|0[xX]|\\x")
_HEX = re.compile(r"(?:[0-9a-fA-F]{2})+")
_STANDARD_INPUT = "-"
FASTEST_FIRST: tuple[int, ...] = tuple(sorted(BAUDS, reverse=True))
"""The baud rates to try: 9600 is a unit's default, and the quickest."""
INTERRUPTED = 130
"""The exit code that a shell reports for a program ended by SIGINT."""
BUS_NAME = "line-1"
_SOCKET = "socket://"
_KINDS = {"digimax": "found_digimax", "garbled": "found_kind_garbled", "foreign": "found_kind_foreign"}


@click.command
@click.argument("hex_bytes", nargs=-1, metavar="HEX…", help="Bytes as hex; - reads standard input.")
@click.option("--file", type=PATH, help="A trace file, or a file of hex.")
@json_option
def decode(hex_bytes: tuple[str, ...], file: Path | None, as_json: bool) -> None:
    """Decode frames. Exit 0, 1 when no frame is valid, 2 when the bytes are not hex."""
    found = _decode_text(_given_text(hex_bytes, file))
    frames = [item for item in found if isinstance(item, Described)]
    if as_json:
        click.echo(json.dumps([frame.as_json() for frame in frames]))
    else:
        for item in found:
            click.echo(f"{item.wire.hex(' ').upper()}\n    {item.meaning}")
    if not any(frame.checksum_ok for frame in frames):
        complain(Message("no_valid_frame"))
        raise click.exceptions.Exit(1)


def _decode_text(text: str) -> list[Described | DescribedNoise]:
    """Decode a trace or a run of hex. Raise CallerError for other text."""
    lines = [line for line in text.splitlines() if line.strip()]
    if any(is_trace_line(line) for line in lines):
        return _decode_trace([parse_trace_line(line) for line in lines])
    return describe_bytes(parse_hex(text))


def parse_hex(text: str) -> bytes:
    """Return bytes from hex in any case, with or without 0x, blanks, commas, brackets. Raise CallerError that
    names the invalid part."""
    tokens = [token for token in _SEPARATORS.split(text) if token]
    if not tokens:
        raise CallerError(Message("bytes_missing"))
    for token in tokens:
        if not _HEX.fullmatch(token):
            raise CallerError(Message.of("bytes_malformed", text=token[:40]))
    return bytes.fromhex("".join(tokens))


def _decode_trace(traced: list[Frame]) -> list[Described | DescribedNoise]:
    """Decode each direction as a separate stream, a response with the request before it."""
    dialect = Dialect()
    describer = Describer(dialect)
    streams = {"out": FrameDecoder(dialect), "in": FrameDecoder(dialect)}
    described = [
        item for frame in traced for item in describer.describe(streams[frame.direction].feed(frame.data))
    ]
    for stream in streams.values():
        described += describer.describe(stream.flush())
    return described


def _given_text(hex_bytes: tuple[str, ...], file: Path | None) -> str:
    if file is not None:
        if hex_bytes:
            raise CallerError(Message("bytes_and_file"))
        return file.read_text(encoding="utf-8", errors="replace")
    if hex_bytes == (_STANDARD_INPUT,):
        return sys.stdin.read()
    return " ".join(hex_bytes)


@click.command
@click.option("--port", required=True, help="A device path, socket://host:port or rfc2217://host:port.")
@click.option(
    "--baud",
    type=click.Choice(FASTEST_FIRST),
    help="Only this baud rate; else all six, fastest first, until a unit responds.",
)
@click.option("--first", type=ADDRESS, default=1, help="The first address to poll.")
@click.option("--last", type=ADDRESS, default=255, help="The last address to poll.")
@click.option(
    "--turnaround-ms",
    type=click.FloatRange(0, 5000),
    default=50.0,
    help="Milliseconds that a unit may take to start its response.",
)
@click.option("--every-baud", is_flag=True, help="Scan at all six baud rates, even after a response.")
@json_option
@click.option("--toml", "as_toml", is_flag=True, help="The result as a [[bus]] to paste into lineside.toml.")
def scan(
    port: str,
    baud: int | None,
    first: int,
    last: int,
    turnaround_ms: float,
    every_baud: bool,
    as_json: bool,
    as_toml: bool,
) -> None:
    """Poll every address, twice if it does not respond; nothing is written to any unit.

    Exit 0 when a unit responded, 1 when none did, 130 when interrupted by Ctrl-C. The JSON has the reason as
    `failure` unless it is 0.
    """
    _refuse_wrong_use(port, first, last, as_json and as_toml)
    bauds, turnaround_s = bauds_to_try(port, baud), turnaround_ms / 1000
    addresses = range(first, last + 1)
    report(announcement(port, bauds, addresses, turnaround_s, every_baud), err=True)
    scans: list[BaudScan] = []
    failures, code = [], 1
    try:
        asyncio.run(scan_bauds(scans, port, bauds, addresses, turnaround_s, every_baud))
    except LinesideError as error:
        failures = [error.message, *([Message("scan_port_lost")] if units_of(scans) else [])]
    except KeyboardInterrupt:
        failures, code = [Message("scan_interrupted")], INTERRUPTED
    is_complete = not failures
    if is_complete and not units_of(scans):
        failures = [Message.of("scan_no_response", bauds=[done.baud for done in scans])]
    if as_json:
        document = _document(port, scans, turnaround_ms)
        why = maybe_shown(failures[0] if failures else None)
        click.echo(json.dumps({**document, "complete": is_complete, "failure": why}))
    elif as_toml and (is_complete or units_of(scans)):
        click.echo(bus_table(port, units_of(scans), allowed_ms(scans)), nl=False)
    elif not as_toml:
        _print(scans, turnaround_ms)
    for failure in failures:
        complain(failure)
    if failures:
        raise click.exceptions.Exit(code)


def _refuse_wrong_use(port: str, first: int, last: int, is_twofold: bool) -> None:
    try:
        check_port(port)
    except ValueError as error:
        raise wrong_option(
            "--port", "option_port_refused", port=without_credentials(repr(port)), reason=error.args[0]
        ) from error
    if is_twofold:
        raise wrong_option("--toml", "option_not_both", other="--json")
    if first > last:
        raise wrong_option("--first", "option_first_above_last", first=first, last=last)


def bauds_to_try(port: str, baud: int | None) -> tuple[int, ...]:
    """Return the baud rates to try. A device server sets its own: 9600 is assumed for its pace."""
    if baud is not None:
        return (baud,)
    return (9600,) if port.startswith(_SOCKET) else FASTEST_FIRST


def announcement(
    port: str, bauds: Sequence[int], addresses: range, turnaround_s: float, every_baud: bool
) -> Message:
    """Return the message that announces a scan and its duration."""
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
    """Scan at one baud rate after another, by default until a unit responds. Each adds to ``scans`` as it
    begins, so that an early end keeps the results. Raise WireError."""
    for baud in bauds:
        scans.append(BaudScan(baud, turnaround_s))
        length = PASSES * len(addresses)
        with click.progressbar(length=length, label=f"{baud:>5} baud", file=sys.stderr) as bar:
            await scan_baud(scans[-1], port, addresses, bar.update)
        if scans[-1].found and not every_baud:
            break


def units_of(scans: Sequence[BaudScan]) -> list[Found]:
    """Return the devices that responded, in the order of the scan."""
    return [one for done in scans for one in done.found]


def allowed_ms(scans: Sequence[BaudScan]) -> int:
    """Return the longest turnaround that units were allowed, in milliseconds."""
    return max((round(1000 * done.turnaround_s) for done in scans), default=0)


def _remarks_on(scans: Sequence[BaudScan], turnaround_ms: float) -> list[Message]:
    """Return remarks on the port as a whole."""
    remarks = conclude(units_of(scans))
    if any(done.echoes for done in scans):
        remarks.append(Message("scan_echo"))
    if (needed_ms := allowed_ms(scans)) > turnaround_ms:
        remarks.append(Message.of("scan_turnaround", value=needed_ms))
    return remarks


def _document(port: str, scans: Sequence[BaudScan], turnaround_ms: float) -> dict[str, Any]:
    found = units_of(scans)
    return {
        "port": port,
        "bauds": [{"baud": done.baud, "seconds": round(done.seconds, 3)} for done in scans],
        "units": [_unit_json(one) for one in found],
        **_remarks(_remarks_on(scans, turnaround_ms)),
        "settings": {**settings_seen(found), "turnaround_ms": allowed_ms(scans)},
        "bus": _bus_found(port, found, allowed_ms(scans)),
    }


def _print(scans: Sequence[BaudScan], turnaround_ms: float) -> None:
    for one in units_of(scans):
        report(_line(one))
        for remark in one.remarks:
            click.echo(f"    {remark}")
    for remark in _remarks_on(scans, turnaround_ms):
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


def _bus_found(port: str, found: Sequence[Found], turnaround_ms: float) -> dict[str, Any]:
    """Return the ``[[bus]]`` of a scan, with its drives in the order of addresses. A bus has one baud rate:
    that of most units. ``turnaround_ms``: the turnaround that was needed."""
    drives = [one for one in found if one.kind == "digimax"]
    baud = Counter(one.baud for one in drives).most_common(1)[0][0] if drives else 9600
    own = [one for one in drives if one.baud == baud]
    settings = {key: value for key, value in settings_seen(own).items() if value is not None}
    units = [{"id": one.unit, "name": f"Unit {one.unit}"} for one in own]
    bus = {"name": BUS_NAME, "port": port, "baud": baud, "turnaround_ms": turnaround_ms}
    return {**bus, **settings, "unit": units}


def bus_table(port: str, found: Sequence[Found], turnaround_ms: float) -> str:
    """Return the bus as TOML, with a comment for each device that is not part of it."""
    bus = _bus_found(port, found, turnaround_ms)
    lines = bus_lines(bus)
    own = {(unit["id"], bus["baud"]) for unit in bus["unit"]}
    lines += [
        f"# Address {one.unit} at {one.baud} baud: {one.kind}."
        for one in found
        if (one.unit, one.baud) not in own
    ]
    return "".join(f"{line}\n" for line in lines)


F = TypeVar("F", bound=Callable[..., Any])


def _dialect_option(name: str, words: str) -> Callable[[F], F]:
    """Return an option for a detail that the manual leaves open; its values are those of lineside.toml."""
    field = Dialect.model_fields[name]
    values = click.Choice(get_args(field.annotation))
    return click.option(f"--{name.replace('_', '-')}", type=values, default=field.default, help=words)


@click.command
@click.option("--units", type=ADDRESS, default=8, help="Number of units, at addresses 1, 2, …")
@click.option("--baud", type=click.Choice(BAUDS), default=9600, help="Baud rate (parameter 18).")
@click.option("--tcp", type=TCP_PORT, help="Serve a TCP port instead; 0 takes a free one.")
@click.option("--seed", default=1, help="The same seed gives the same line.")
@click.option("--link", type=PATH, help="A symbolic link to the pseudo-terminal.")
@click.option(
    "--turnaround-ms",
    type=click.FloatRange(0, 5000),
    default=0.0,
    help="Milliseconds until a unit starts its response.",
)
@_dialect_option("checksum_10h", "How a checksum of 10h is sent and accepted.")
@_dialect_option("parameter_reply_bytes", "Bytes of a response to 85h; 0 uses the width of the type.")
@_dialect_option("parameter_numbers", "Parameter numbers on the wire.")
@_dialect_option("estop_healthy", "The e-stop bit while no emergency stop is active.")
@click.option(
    "--last-parameter",
    type=click.IntRange(1, 40),
    default=40,
    help="Last parameter of the firmware: 20 in the older list.",
)
@click.option(
    "--speedup",
    type=click.FloatRange(1, 1000),
    default=1.0,
    help="Factor by which byte times and turnarounds are shortened.",
)
@click.option(
    "--script/--no-script",
    default=True,
    help="Operate run, preset, jog and emergency stop from time to time.",
)
@click.option(
    "--unrest/--no-unrest", default=True, help="Let speeds and tensions move a little, as on a machine."
)
@click.option("--control", type=TCP_PORT, help="Accept control requests as JSON lines at this TCP port.")
def simulate(
    units: int,
    baud: int,
    tcp: int | None,
    seed: int,
    link: Path | None,
    turnaround_ms: float,
    last_parameter: int,
    speedup: float,
    script: bool,
    unrest: bool,
    control: int | None,
    **dialect: Any,
) -> None:
    """Run simulated units only. The first printed line is the port to open. End by Ctrl-C or SIGTERM."""
    if tcp is not None and link is not None:
        raise wrong_option("--link", "option_link_with_tcp")
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS)
    traits = Traits(Dialect(**dialect), last_parameter, turnaround_s=turnaround_ms / 1000)
    plant = demo_line(units, seed=seed, traits=traits, script=script, unrest=unrest).plant
    for unit in plant.units:
        unit.memory[numbers.BAUD_RATE] = baud // 100
        unit.power_up()
    line = SimulatedLine(plant, Faults(seed), baud, speedup)
    with LineServer(line, _open(tcp, link, baud)) as server, ExitStack() as opened:
        click.echo(server.port.name)
        if control is not None:
            click.echo(f"control 127.0.0.1:{opened.enter_context(control_port(server, control))}")
        signal.sigwait(_ENDINGS)


_ENDINGS = {signal.SIGINT, signal.SIGTERM}


def _open(tcp: int | None, link: Path | None, baud: int) -> Port:
    try:
        return PtyPort(link, baud) if tcp is None else TcpLinePort(tcp)
    except OSError as error:
        why = str(error.strerror)
        if tcp is None:
            raise LinesideError(Message.of("simulator_link_refused", link=str(link), error=why)) from error
        raise LinesideError(Message.of("simulator_port_refused", port=tcp, error=why)) from error
