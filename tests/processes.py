"""``pytest --processes N`` runs the files of tests in N processes, each the next one that is left.

They are forked from the process that has collected the tests. To import the product and collect takes six
seconds, which each process of pytest-xdist takes for itself, after one that does nothing else, so that not
all of them compile the tests: a tenth of what all tests take on two cores.

``--processes 2+4+2`` forks so many for each pool of tests: those with a browser, those that mostly wait for a
server or a line, and those that mostly compute. The cores then always have something to do, and there are
never more browsers than the first number. A process whose pool has no file left takes those of another pool.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any

import pytest

POOLS = (("e2e",), ("path", "tests", "system", "attacks", "cli"))
"""The folders of the first pools, those whose files take longest first. The last pool has all others."""
NICE = 5
"""Browsers come before the other tests in the use of the cores."""
TURN_BYTES = 2
"""The number of a file, in the pipe from which each process takes its next."""


@dataclass
class Process:
    """One that runs tests, as the one that has collected them sees it."""

    pid: int
    reports: Connection
    test: str = "no test"
    """The one that it runs."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the option."""
    about = "run the files of tests in so many processes, or for each pool: browsers+servers+others"
    parser.addoption("--processes", type=counts_of, default=(1,), help=about)


def counts_of(text: str) -> tuple[int, ...]:
    """The number of processes of each pool. Raises ValueError."""
    return tuple(map(int, text.split("+")))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest: short ones fill the time in which the last of those wait."""
    ranks = {folder: rank for rank, folder in enumerate(folder for pool in POOLS for folder in pool)}
    items.sort(key=lambda item: ranks.get(item.path.parent.name, len(ranks)))


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    """Run the tests in processes; None where pytest itself shall run them, or refuse to."""
    counts, option = session.config.getoption("processes"), session.config.option
    if sum(counts) == 1 or option.collectonly or session.testsfailed:
        return None
    files = [list(items) for _, items in groupby(session.items, key=lambda item: item.path)]
    turns = [turns_of(files, pool, len(counts)) for pool in range(len(counts))]
    processes: list[Process] = []
    for pool in (pool for pool, count in enumerate(counts) for _ in range(count)):
        reports, reporting = Pipe(duplex=False)
        session.config.get_terminal_writer().flush()
        if not (pid := os.fork()):
            start_reporting(session, reporting)
            run_pools(session, turns, files, pool)
            return True
        reporting.close()
        processes.append(Process(pid, reports))
    follow(session, turns, processes)
    return True


def turns_of(files: Sequence[Sequence[pytest.Item]], pool: int, pools: int) -> int:
    """A pipe with the number of each file of a pool in order, which ends with the last."""
    turns, writing = os.pipe()
    numbers = (number for number, items in enumerate(files) if pool_of(items[0], pools) == pool)
    os.write(writing, b"".join(number.to_bytes(TURN_BYTES) for number in numbers))
    os.close(writing)
    return turns


def pool_of(item: pytest.Item, pools: int) -> int:
    """The number of the pool of a test, of so many."""
    first = (number for number, folders in enumerate(POOLS) if item.path.parent.name in folders)
    return min(next(first, len(POOLS)), pools - 1)


# --- in each process -------------------------------------------------------------------------------


def start_reporting(session: pytest.Session, reporting: Connection) -> None:
    """Be silent, and send the reports of the tests to the process that has collected them."""
    plugins = session.config.pluginmanager
    plugins.unregister(name="terminalreporter")
    plugins.register(Reporting(session.config, reporting))
    capturing: Any = plugins.getplugin("capturemanager")
    capturing.stop_global_capturing()  # its file is that of all processes
    capturing.start_global_capturing()
    capturing.suspend_global_capture()


def run_pools(
    session: pytest.Session, turns: Sequence[int], files: Sequence[Sequence[pytest.Item]], first: int
) -> None:
    """Run the files of a pool until none is left, then those of the others, but no browsers. Between two
    pools the fixtures of the session end: the event loop of a browser is in the way of other tests."""
    for pool in (first, *range(first + 1, len(turns)), *range(1, first)):
        if pool:
            os.setpriority(os.PRIO_PROCESS, 0, max(NICE, os.getpriority(os.PRIO_PROCESS, 0)))
        run_turns(session, items_in_turn(turns[pool], files))


def run_turns(session: pytest.Session, items: Iterator[pytest.Item]) -> None:
    """Run one test after the other, and end the fixtures with the last."""
    item = next(items, None)
    while item:
        following = next(items, None)
        session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        item = following


def items_in_turn(turns: int, files: Sequence[Sequence[pytest.Item]]) -> Iterator[pytest.Item]:
    """The tests of each file that this process takes."""
    while number := os.read(turns, TURN_BYTES):
        yield from files[int.from_bytes(number)]


class Reporting:
    """Sends the reports of each test, together at its end, to the process that has collected the tests."""

    def __init__(self, config: pytest.Config, connection: Connection) -> None:
        self._config = config
        self._connection = connection
        self._reports: list[Any] = []

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Name the test that runs."""
        self._connection.send(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep it. That of a setup or teardown without a fault states nothing, and would cost as much."""
        if report.when == "call" or not report.passed:
            to_send = self._config.hook.pytest_report_to_serializable
            self._reports.append(to_send(config=self._config, report=report))

    def pytest_runtest_logfinish(self, nodeid: str, location: tuple[str, int | None, str]) -> None:
        """Send what was reported."""
        self._connection.send((nodeid, location, self._reports))
        self._reports = []


# --- in the one that has collected them ------------------------------------------------------------


def follow(session: pytest.Session, turns: Sequence[int], processes: Sequence[Process]) -> None:
    """Report what the processes report, until all have ended."""
    running = {process.reports: process for process in processes}
    while running:
        ready = wait(running)
        for process in [process for process in running.values() if process.reports in ready]:
            try:
                follow_one(session, process)
            except EOFError:
                del running[process.reports]
                judge_end(session, process)
        if session.shouldfail or session.shouldstop:
            for each in turns:
                while os.read(each, TURN_BYTES):
                    """No process takes another file."""
    if session.shouldfail:
        raise session.Failed(session.shouldfail)
    if session.shouldstop:
        raise session.Interrupted(session.shouldstop)


def follow_one(session: pytest.Session, process: Process) -> None:
    """Take its next message. Raises EOFError where it has ended."""
    match process.reports.recv():
        case str(test):
            process.test = test
        case nodeid, location, reports:
            report_again(session, reports)
            session.config.hook.pytest_runtest_logfinish(nodeid=nodeid, location=location)


def report_again(session: pytest.Session, messages: Sequence[dict[str, Any]]) -> None:
    """Give reports to the plugins of this process, as if the test had run here."""
    hook = session.config.hook
    for message in messages:
        report = hook.pytest_report_from_serializable(config=session.config, data=message)
        hook.pytest_runtest_logreport(report=report)


def judge_end(session: pytest.Session, process: Process) -> None:
    """Fail the session where a process has not reached the end of its tests."""
    code = os.waitstatus_to_exitcode(os.waitpid(process.pid, 0)[1])
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        session.shouldfail = f"a process of the tests ended with {code}, while it ran {process.test}"
