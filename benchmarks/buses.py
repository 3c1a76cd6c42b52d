"""What a bus worker costs of the machine, alone and beside others."""

from __future__ import annotations

import multiprocessing
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path

from benchmarks.processes import cpu_seconds, family, memory_mib
from benchmarks.served import served_lines
from benchmarks.tables import microseconds, show
from benchmarks.witness import SHORTEST_POLL_RESPONSE
from bus.simulator.line import SimulatedLine, WireEventKind
from bus.simulator.plant import demo_line
from bus.simulator.ports import PtyPort
from bus.simulator.serve import LineServer
from tests.e2e.site import eventually

FORK = multiprocessing.get_context("fork")
UNITS = 8
BAUD = 9600
COUNTS = (1, 4, 16)
BEGUN_WITHIN_S = 45.0
"""A machine with other work may not start sixteen at all; the table goes on without them."""
ENDED_WITHIN_S = 15.0
SETTLING_S = 5.0
"""After every worker has begun: until the parameters that are needed to show its units have been read."""
MEASURED_S = 10.0


def run() -> None:
    """One table."""
    header = [
        *("buses", "polls/s of each", "CPU of a worker", "the busiest", "of it, a poll"),
        *("CPU of the server", "its memory", "memory of a worker"),
    ]
    note = (
        f"{UNITS} units a bus, {BAUD} baud, paced; {MEASURED_S:g} s. CPU: of a core; at most 3 % for one.\n"
        "  The simulated lines run on the same machine, one process each: with fewer cores than\n"
        "  processes the polls are fewer, and only the cost of one poll counts. Not measured: not every\n"
        f"  worker polled within {BEGUN_WITHIN_S:g} s, or one ended."
    )
    show("What workers cost", header, [[str(count), *_row(count)] for count in COUNTS], note)


def _row(count: int) -> list[str]:
    with (
        tempfile.TemporaryDirectory() as folder,
        _lines(count) as lines,
        _served(Path(folder), lines) as process,
    ):
        try:
            eventually(lambda: all(line.polls() for line in lines), "a worker on each", within=BEGUN_WITHIN_S)
            time.sleep(SETTLING_S)
            return _measure(process.pid, lines)
        except (AssertionError, FileNotFoundError):
            return ["not measured", *[""] * 6]


class _Line:
    """A simulated line in a separate process, made by a fork to start quickly."""

    def __init__(self, seed: int) -> None:
        here, there = FORK.Pipe()
        FORK.Process(target=_play, args=(seed, there), daemon=True).start()
        there.close()
        self._pipe = here
        self.port: str = here.recv()

    def polls(self) -> int:
        """The number of polls with a response."""
        self._pipe.send("polls")
        polls: int = self._pipe.recv()
        return polls

    def close(self) -> None:
        """Power off."""
        self._pipe.close()


def _play(seed: int, pipe: Connection) -> None:
    line = SimulatedLine(demo_line(UNITS, seed=seed, script=False).plant)
    with LineServer(line, PtyPort(baud=BAUD)) as server, suppress(EOFError):
        pipe.send(server.port.name)
        while pipe.recv():
            responses = line.record.since(0, WireEventKind.RESPONDED)
            pipe.send(sum(len(entry.data) >= SHORTEST_POLL_RESPONSE for entry in responses))


@contextmanager
def _lines(count: int) -> Iterator[list[_Line]]:
    with ExitStack() as stack:
        yield [stack.enter_context(closing(_Line(seed))) for seed in range(1, count + 1)]


@contextmanager
def _ended(process: subprocess.Popen[bytes], within_s: float) -> Iterator[None]:
    """End ``process`` after the block: by SIGTERM; by SIGKILL where that takes longer than ``within_s``."""
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(within_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextmanager
def _served(folder: Path, lines: Sequence[_Line]) -> Iterator[subprocess.Popen[bytes]]:
    command = served_lines(folder, [line.port for line in lines], UNITS)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    with _ended(process, ENDED_WITHIN_S):
        yield process


def _measure(server: int, lines: Sequence[_Line]) -> list[str]:
    _, *workers = family(server)
    begun, before = time.monotonic(), sum(line.polls() for line in lines)
    used = {process: cpu_seconds(process) for process in (server, *workers)}
    time.sleep(MEASURED_S)
    seconds = time.monotonic() - begun
    rate = (sum(line.polls() for line in lines) - before) / seconds / len(lines)
    cpu = {process: (cpu_seconds(process) - used[process]) / seconds for process in used}
    each = [cpu[worker] for worker in workers]
    mean = sum(each) / len(each)
    return [
        f"{rate:.1f}",
        f"{mean:.2%}",
        f"{max(each):.2%}",
        microseconds(mean / rate) if rate else "",
        f"{cpu[server]:.2%}",
        f"{memory_mib(server):.0f} MiB",
        f"{memory_mib(*workers) / len(workers):.0f} MiB",
    ]
