"""The command ``lineside demo``: a simulated line and its dashboard, without configuration."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click

from app.cli.command import ADDRESS, TCP_PORT
from app.cli.starting import listen, listen_from
from app.core.server.service_manager import ServiceManager
from app.errors import StoreError
from app.settings import load
from bus.configuration import bus_lines
from bus.instants import monotonic_now
from bus.messages import Message
from bus.settings import UnitSettings
from bus.worker.process import tied_environment

HOST, PORT = "127.0.0.1", 8000
CHOOSE = Message("choose_port_demo")


@click.command
@click.option("--units", type=ADDRESS, default=8, help="Number of units.")
@click.option(
    "--port", type=TCP_PORT, help=f"Port of the dashboard; without it {PORT}, or the next that is free."
)
def demo(units: int, port: int | None) -> None:
    """Run a simulated line with a past and its dashboard until Ctrl-C; then delete its data."""
    since = monotonic_now()
    with (
        listen_from(HOST, PORT, CHOOSE) if port is None else listen(HOST, port, CHOOSE) as listening,
        tempfile.TemporaryDirectory(prefix="lineside-demo-") as folder,
    ):
        here, taken = Path(folder), listening.getsockname()[1]
        with _simulator(units, here / "line") as begun:
            # The simulator starts in its own process while this process imports the rest.
            from app.cli.hosting import host
            from app.cli.past import write_past
            from bus.simulator.plant import demo_line

            line, config = demo_line(units), here / "lineside.toml"
            config.write_text(configuration(here / "line", taken, line.settings), encoding="utf-8")
            settings = load(config)
            write_past(settings, line)
            begun()
            host(settings, config, listening, ServiceManager(), since, demo=True)


@contextmanager
def _simulator(units: int, link: Path) -> Iterator[Callable[[], None]]:
    """Run ``lineside simulate`` as a child process; the function that the context returns waits for its
    port."""
    called = [sys.executable, "-P", "-m", "app.cli", "simulate", "--units", str(units), "--link", str(link)]
    process = subprocess.Popen(
        called, stdout=subprocess.PIPE, env=tied_environment(), process_group=0, text=True
    )
    output = process.stdout

    def begun() -> None:
        if output is None or not output.readline():
            raise StoreError(Message("simulator_not_started"))

    with process:
        try:
            yield begun
        finally:
            # It need not end by itself: its port is in the folder that is deleted.
            process.kill()


def configuration(line: Path, port: int, units: Sequence[UnitSettings]) -> str:
    """Return the text of lineside.toml for a demo."""
    unit = [each.model_dump(exclude_defaults=True) for each in units]
    bus = {"name": "demo", "port": str(line), "draw_percent": [-0.5, 1.0], "unit": unit}
    site = ["[site]", 'name = "Demo line"', "simulated = true", "", "[server]", f"port = {port}", ""]
    return "".join(f"{each}\n" for each in (*site, *bus_lines(bus)))
