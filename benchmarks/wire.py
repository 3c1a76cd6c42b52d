"""How much of a 9600 baud wire each host uses, and what a dead unit costs the others."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import httpx

from benchmarks.modbus_line import ModbusLine
from benchmarks.onlookers import onlookers
from benchmarks.processes import cpu_seconds, family, memory_mib
from benchmarks.served import CONFIG, LINESIDE, served_line
from benchmarks.tables import microseconds, show
from benchmarks.witness import Seen, look
from bus.settings import BITS_PER_BYTE
from bus.simulator.line import FaultKind, Faults, SimulatedLine, WireEvent, WireEventKind
from bus.simulator.plant import demo_line
from bus.simulator.ports import PtyPort
from bus.simulator.serve import LineServer
from tests.e2e.limits import START_S
from tests.e2e.site import end, eventually
from tests.postgresql import fresh_database

UNITS = 8
BAUD = 9600
POLL_BYTES = 25
WIRE_ITSELF = BAUD / BITS_PER_BYTE / POLL_BYTES
SETTLING_S = 5.0
LONGEST_SETTLING = 20
READ_PARAMETER = 0x85
READS_OF_A_SETTLED_HOST = 10
"""In ``SETTLING_S``: a worker that knows all parameters looks now and then whether one was changed."""
MEASURED_S = 20.0
WITH_A_BACKUP_S = 65.0
DEAD = 3

ONLOOKERS = 20

Host = Callable[[str, Path], list[str]]
Company = Callable[[Path], AbstractContextManager[None]]


@contextmanager
def _alone(_folder: Path) -> Iterator[None]:
    yield


@contextmanager
def _onlookers(folder: Path) -> Iterator[None]:
    """Pages that are open on a served line, one of them on the trace."""
    config = folder / CONFIG
    arguments = ["token", "create", "onlooker", "--role", "engineer", "--config", str(config)]
    token = subprocess.run([LINESIDE, *arguments], capture_output=True, text=True, check=True).stdout.split()[
        -1
    ]
    number = tomllib.loads(config.read_text(encoding="utf-8"))["server"]["port"]
    url = f"http://127.0.0.1:{number}"
    eventually(lambda: _serves(url), f"a response from {url}", within=START_S)
    with onlookers(url, token, ONLOOKERS, trace="line"):
        yield


def _serves(url: str) -> bool:
    try:
        return httpx.get(f"{url}/healthz", trust_env=False).status_code == 200
    except httpx.HTTPError:
        return False


def run() -> None:
    """Two tables."""
    _show_rates()
    _show_dead_unit()


def _show_rates() -> None:
    rows: list[list[object]] = [["the wire itself", f"{WIRE_ITSELF:.1f}", "1.000", "0", "0", "", ""]]
    for name, (host, company, seconds) in {
        **{name: (host, _alone, MEASURED_S) for name, host in HOSTS.items()},
        f"the same, {ONLOOKERS} browsers and the trace": (_lineside, _onlookers, MEASURED_S),
        f"the same alone, for {WITH_A_BACKUP_S:g} s": (_lineside, _alone, WITH_A_BACKUP_S),
        "the same, publishing, with a backup each minute": (_copying, _alone, WITH_A_BACKUP_S),
    }.items():
        seen, cpu, memory = _measure(host, _line_for(host), company, seconds)
        gaps = [microseconds(seen.gap_median), microseconds(seen.gap_p99)]
        part = f"{seen.octets * BITS_PER_BYTE / BAUD:.3f}"
        rows.append([name, f"{seen.rate:.1f}", part, *gaps, f"{cpu:.1%}", f"{memory:.0f} MiB"])
    header = ["host", "polls/s", "of the wire", "gap median", "gap p99", "CPU of one core", "memory"]
    note = (
        "Of the wire: the byte times of all completed exchanges, polls and the few parameter reads.\n"
        "  Gap: from the last byte of a response to the first byte of the next request. No turnaround.\n"
        "  Lineside keeps its history while it is measured."
    )
    show(f"{UNITS} units at {BAUD} baud, polled for {MEASURED_S:g} s", header, rows, note)


def _show_dead_unit() -> None:
    rows = []
    for name in ("bare asyncio loop", "Lineside, complete"):
        healthy, _, _ = _measure(HOSTS[name], _simulated(Faults()))
        faults = Faults()
        faults.set(FaultKind.DEAD, 1.0, DEAD)
        hurt, _, _ = _measure(HOSTS[name], _simulated(faults))
        others = [hurt.per_unit[unit] / healthy.per_unit[unit] for unit in hurt.per_unit if unit != DEAD]
        rows.append([name, f"{min(others):.2f}", f"{sum(others) / len(others):.2f}", f"{hurt.rate:.1f}"])
    header = ["host", "worst of the seven", "mean of the seven", "polls/s"]
    show(f"One of {UNITS} units is off: what the others keep of their rate", header, rows)


def _measure(
    host: Host, line: Any, company: Company = _alone, lasting_s: float = MEASURED_S
) -> tuple[Seen, float, float]:
    """What the line saw of a host, its share of a core, and its memory in MiB."""
    with (
        tempfile.TemporaryDirectory() as folder,
        LineServer(line, PtyPort(baud=BAUD)) as server,
        _hosted(host(server.port.name, Path(folder))) as process,
        company(Path(folder)),
    ):
        _settle(server)
        members = family(process.pid)
        begun, used, number = time.monotonic(), cpu_seconds(*members), _last_number(server)
        time.sleep(lasting_s)
        seconds = time.monotonic() - begun
        cpu = (cpu_seconds(*members) - used) / seconds
        return look(_record(server, number), seconds), cpu, memory_mib(*members)


def _settle(server: LineServer) -> None:
    """Until the host has begun and read whatever it reads beside polls at first."""
    for _ in range(LONGEST_SETTLING):
        number = _last_number(server)
        time.sleep(SETTLING_S)
        requests = [entry for entry in _record(server, number) if entry.what is WireEventKind.RECEIVED]
        reads = sum(entry.data[1] == READ_PARAMETER for entry in requests)
        if _last_number(server) > number and reads <= READS_OF_A_SETTLED_HOST:
            return


def _record(server: LineServer, since: int) -> list[WireEvent]:
    return server.call(lambda line: list(line.record.since(since)))


def _last_number(server: LineServer) -> int:
    return server.call(lambda line: line.record.count)


@contextmanager
def _hosted(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        end(process)


def _peer(module: str) -> Host:
    return lambda port, _folder: [sys.executable, "-m", f"benchmarks.peers.{module}", port, str(UNITS)]


def _lineside(port: str, folder: Path) -> list[str]:
    return served_line(folder, port, UNITS)


def _copying(port: str, folder: Path) -> list[str]:
    """Lineside that publishes every reading to PostgreSQL, and backs itself up each minute."""
    with fresh_database() as url:
        more = (
            f'[postgresql]\nurl = "{url}"\nreadings = "all"\n[backup]\nfolder = "backups"\nevery = "1 min"\n'
        )
        return served_line(folder, port, UNITS, more)


def _line_for(host: Host) -> Any:
    return ModbusLine(BAUD) if host in (HOSTS["pymodbus"], HOSTS["minimalmodbus"]) else _simulated(Faults())


def _simulated(faults: Faults) -> SimulatedLine:
    return SimulatedLine(demo_line(UNITS, script=False).plant, faults, BAUD)


HOSTS: dict[str, Host] = {
    "bare asyncio loop": _peer("bare"),
    "pymodbus": _peer("pymodbus_loop"),
    "minimalmodbus": _peer("minimalmodbus_loop"),
    "Lineside, complete": _lineside,
}
