"""``lineside simulate``: simulated units alone, at a port to open."""

from __future__ import annotations

import signal
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, get_args

import click
from pydantic import ValidationError

from app.cli.ending import wrong_option
from app.cli.options import Option
from bus.catalogue import numbers
from bus.errors import LinesideError
from bus.messages import Message
from bus.settings import BAUDS, Baud, Dialect
from bus.simulator.control import control_port
from bus.simulator.demo import demo_line
from bus.simulator.faults import Faults
from bus.simulator.line import SimulatedLine
from bus.simulator.ports import Port, PtyPort, TcpLinePort
from bus.simulator.serve import LineServer
from bus.simulator.unit import Traits
from bus.validation import fault_message


def simulate(
    units: Annotated[int, Option(min=1, max=255, help="Number of units, at addresses 1, 2, …")] = 8,
    baud: Annotated[int, Option(help="Baud rate (parameter 18): 300 to 9600.")] = 9600,
    tcp: Annotated[
        int | None, Option(min=0, max=65535, help="Serve a TCP port instead; 0 takes a free one.")
    ] = None,
    seed: Annotated[int, Option(help="The same seed gives the same line.")] = 1,
    link: Annotated[Path | None, Option(help="A symbolic link to the pseudo-terminal.")] = None,
    turnaround_ms: Annotated[
        float, Option(min=0, max=5000, help="Milliseconds until a unit starts its response.")
    ] = 0.0,
    checksum_10h: Annotated[
        str, Option("--checksum-10h", help="How a checksum of 10h is sent and accepted: once or twice.")
    ] = "once",
    parameter_reply_bytes: Annotated[
        int,
        Option(help="Bytes of a response to 85h: 1, 2 or 4; 0 uses the width of the parameter's type."),
    ] = 0,
    parameter_numbers: Annotated[
        str, Option(help="Parameter numbers on the wire: binary or bcd.")
    ] = "binary",
    estop_healthy: Annotated[
        int, Option(help="The e-stop bit while no emergency stop is active: 0 or 1.")
    ] = 1,
    last_parameter: Annotated[
        int, Option(min=1, max=40, help="Last parameter of the firmware: 20 in the older list.")
    ] = 40,
    speedup: Annotated[
        float, Option(min=1, max=1000, help="Factor by which byte times and turnarounds are shortened.")
    ] = 1.0,
    script: Annotated[
        bool, Option(help="Operate run, preset, jog and emergency stop from time to time.")
    ] = True,
    unrest: Annotated[bool, Option(help="Let speeds and tensions move a little, as on a machine.")] = True,
    control: Annotated[
        int | None,
        Option(min=0, max=65535, help="Accept control requests as JSON lines at this TCP port."),
    ] = None,
) -> None:
    """Run simulated units only. The first line printed is the port to open. Ends with Ctrl-C or SIGTERM."""
    if baud not in BAUDS:
        raise wrong_option("--baud", "option_none_of", value=baud, known=list(get_args(Baud)))
    if tcp is not None and link is not None:
        raise wrong_option("--link", "option_link_with_tcp")
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS)
    dialect = _dialect(
        checksum_10h=checksum_10h,
        parameter_reply_bytes=parameter_reply_bytes,
        parameter_numbers=parameter_numbers,
        estop_healthy=estop_healthy,
    )
    traits = Traits(dialect, last_parameter, turnaround_s=turnaround_ms / 1000)
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


def _dialect(**options: str | int) -> Dialect:
    """What the manual leaves open, as these units decide it; the options are called as in lineside.toml."""
    try:
        return Dialect.model_validate(options)
    except ValidationError as error:
        first = error.errors()[0]
        option = "--" + str(first["loc"][0]).replace("_", "-")
        raise click.BadParameter(str(fault_message(first)), param_hint=option) from error


_ENDINGS = {signal.SIGINT, signal.SIGTERM}


def _open(tcp: int | None, link: Path | None, baud: int) -> Port:
    try:
        return PtyPort(link, baud) if tcp is None else TcpLinePort(tcp)
    except OSError as error:
        why = str(error.strerror)
        if tcp is None:
            raise LinesideError(Message.of("simulator_link_refused", link=str(link), error=why)) from error
        raise LinesideError(Message.of("simulator_port_refused", port=tcp, error=why)) from error
