"""``pytest --processes N`` runs the files of tests in N processes, each the next one that is left.

They are forked from the process that has collected the tests. To import the product and collect takes six
seconds, which each process of pytest-xdist takes for itself, after one that does nothing else, so that not
all of them compile the tests: a tenth of what all tests take on two cores.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any

import pytest

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
    parser.addoption("--processes", type=int, default=1, help="run the files of tests in so many processes")


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    """Run the tests in processes; None where pytest itself shall run them, or refuse to."""
    count, option = session.config.getoption("processes"), session.config.option
    if count == 1 or option.collectonly or session.testsfailed:
        return None
    files = [list(items) for _, items in groupby(session.items, key=lambda item: item.path)]
    turns = turns_of(len(files))
    processes: list[Process] = []
    for _ in range(count):
        reports, reporting = Pipe(duplex=False)
        session.config.get_terminal_writer().flush()
        if not (pid := os.fork()):
            run_turns(session, turns, files, reporting)
            return True
        reporting.close()
        processes.append(Process(pid, reports))
    follow(session, turns, processes)
    return True


def turns_of(files: int) -> int:
    """A pipe with the number of each file in order, which ends with the last."""
    turns, writing = os.pipe()
    os.write(writing, b"".join(number.to_bytes(TURN_BYTES) for number in range(files)))
    os.close(writing)
    return turns


# --- in each process -------------------------------------------------------------------------------


def run_turns(
    session: pytest.Session, turns: int, files: Sequence[Sequence[pytest.Item]], reporting: Connection
) -> None:
    """Run one file after the other until none is left. The session then ends as any does, silently."""
    plugins = session.config.pluginmanager
    plugins.unregister(name="terminalreporter")
    plugins.register(Reporting(session.config, reporting))
    capturing: Any = plugins.getplugin("capturemanager")
    capturing.stop_global_capturing()  # its file is that of all processes
    capturing.start_global_capturing()
    capturing.suspend_global_capture()
    items = items_in_turn(turns, files)
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


def follow(session: pytest.Session, turns: int, processes: Sequence[Process]) -> None:
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
            while os.read(turns, TURN_BYTES):
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
