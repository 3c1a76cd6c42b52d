"""``lineside simulate``: simulated units alone, at a port to open."""

from __future__ import annotations

import signal
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeVar, get_args

import click

from app.cli.options import ADDRESS, PATH, TCP_PORT
from app.cli.process import wrong_option
from bus.catalogue import parameters as numbers
from bus.errors import LinesideError
from bus.messages import Message
from bus.settings import BAUDS, Dialect
from bus.simulator.line import Faults, SimulatedLine
from bus.simulator.plant import demo_line
from bus.simulator.ports import Port, PtyPort, TcpLinePort
from bus.simulator.serve import LineServer, control_port
from bus.simulator.unit import Traits

F = TypeVar("F", bound=Callable[..., Any])


def _dialect_option(name: str, words: str) -> Callable[[F], F]:
    """Make an option for what the manual leaves open; its values are those of lineside.toml."""
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
    """Run simulated units only. The first line printed is the port to open. Ends with Ctrl-C or SIGTERM."""
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
