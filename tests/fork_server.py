"""The commands of Lineside as processes that are forked, not started: their modules are imported once for
all tests of a run, which takes most of the time of a start.

``start("serve", "--config", path, stdout=log)`` gives a process, ``run("token", "list", …)`` what a command
printed. The forked process runs the entry point of the package, with its own arguments, environment, folder,
umask and standard streams. A server forks its bus workers too, unless it is to start them. How an installed
program starts is the subject of `tests.app.system.test_configuration_restart`, `tests.test_service_unit` and
`tests.test_package`, which start it.
"""

from __future__ import annotations

import asyncio
import atexit
import gc
import json
import os
import selectors
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import IO, Any, Literal
from uuid import uuid4

Program = Literal["lineside", "bus"]
RUN = os.environ.setdefault("LINESIDE_TESTS_RUN", uuid4().hex[:12])
"""This run of the tests: what its processes share has it in its name."""
ROOT = Path(__file__).resolve().parent.parent
ENTRY_POINTS: dict[Program, tuple[str, str]] = {
    "lineside": ("app.cli", str(Path(sys.executable).with_name("lineside"))),
    "bus": ("bus.__main__", str(ROOT / "bus" / "__main__.py")),
}
"""Module that has ``main``, and the program's name in ``sys.argv``."""
IMPORTED = ("app.cli.hosting", "app.cli.server", "app.cli.wire", "app.cli.accounts", "bus.worker.service")
"""Before the first fork. None of them starts a thread."""
MAX_BYTES = 200_000
"""Of a request: mostly the environment."""
REPORT = struct.Struct("i")
"""The process id, then the exit code."""


class ForkedProcess:
    """A process as `subprocess.Popen` gives it: ``stdout`` and ``stderr`` are what comes out of a pipe."""

    def __init__(self, status: int, stdout: IO[str] | None, stderr: IO[str] | None) -> None:
        self._status = os.fdopen(status, "rb", buffering=0)
        self._exited = select_on(self._status)
        self.stdout, self.stderr = stdout, stderr
        self.returncode: int | None = None
        self.pid = self._next_report()

    def poll(self) -> int | None:
        """The exit code; None while it runs."""
        return self._result(0)

    def wait(self, timeout: float | None = None) -> int:
        """The exit code, minus the signal that ended it. Raises subprocess.TimeoutExpired."""
        code = self._result(timeout)
        if code is None:
            raise subprocess.TimeoutExpired(f"forked process {self.pid}", timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """Nothing where it has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it has ended, and its report is on the way
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """By SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """By SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def _result(self, timeout: float | None) -> int | None:
        if self.returncode is None and self._exited.select(timeout):
            self.returncode = self._next_report()
            self._exited.close()
            self._status.close()
        return self.returncode

    def _next_report(self) -> int:
        report = self._status.read(REPORT.size)
        assert report, "the fork server has ended; its error output is that of the tests"
        number: int = REPORT.unpack(report)[0]
        return number


def start(
    *words: str | Path,
    program: Program = "lineside",
    stdin: IO[Any] | None = None,
    stdout: IO[Any] | int | None = None,
    stderr: IO[Any] | int | None = None,
    env: Mapping[str, str] | None = None,
    cwd: Path | None = None,
    umask: int = -1,
    forks_workers: bool = True,
) -> ForkedProcess:
    """Run a command of the program. ``stdout`` and ``stderr`` may be `subprocess.PIPE`. Those that are not
    given are the streams of the tests; without ``stdin`` there is no input. ``forks_workers``: a server forks
    its bus workers, whose command line is then that of the fork server; otherwise it starts them.
    """
    printed, output = _stream(stdout, sys.__stdout__)
    complaints, errors = _stream(stderr, sys.__stderr__)
    status, reported = os.pipe()
    request = {
        "program": program,
        "words": [str(word) for word in words],
        "environment": dict(os.environ if env is None else env),
        "folder": str(cwd or Path.cwd()),
        "umask": umask,
        "forks_workers": forks_workers,
    }
    with Path(os.devnull).open("rb") as nothing:
        streams = (stdin or nothing).fileno(), output, errors, reported
        socket.send_fds(_server(), [json.dumps(request).encode()], streams)
    os.close(reported)
    for reading, writing in ((printed, output), (complaints, errors)):
        if reading is not None:
            os.close(writing)
    return ForkedProcess(status, printed, complaints)


def run(*words: str | Path, text: str = "", **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a command to its end with ``text`` on its standard input; options are those of `start`."""
    with ExitStack() as stack:
        given, *printed = (stack.enter_context(tempfile.TemporaryFile("w+")) for _ in range(3))
        given.write(text)
        given.seek(0)
        code = start(*words, stdin=given, stdout=printed[0], stderr=printed[1], **options).wait()
        for file in printed:
            file.seek(0)
        output, errors = (file.read() for file in printed)
    return subprocess.CompletedProcess([str(word) for word in words], code, output, errors)


def run_at_once(pid: int = 0) -> None:
    """Give a process its turn as soon as it has something to do, this one by default: a line that is late
    looks as one that is broken. A priority counts among the processes of a session alone (autogroup,
    sched(7)), and browsers have their own: beside them it leaves a process waiting for 0.1 s and more."""
    with suppress(PermissionError):
        os.sched_setscheduler(pid, os.SCHED_RR, os.sched_param(1))


def select_on(file: Any) -> selectors.BaseSelector:
    """Selects this one for reading."""
    selector = selectors.DefaultSelector()
    selector.register(file, selectors.EVENT_READ)
    return selector


def _stream(given: IO[Any] | int | None, default: IO[Any] | None) -> tuple[IO[str] | None, int]:
    """What to read where it is a pipe, and the descriptor that the process gets."""
    if given == subprocess.PIPE:
        reading, writing = os.pipe()
        return os.fdopen(reading, encoding="utf-8"), writing
    chosen = given or default
    assert chosen is not None
    return None, chosen if isinstance(chosen, int) else chosen.fileno()


@cache
def _server() -> socket.socket:
    """The connection to the fork server. All processes of a run have one together, which ends with the last
    of them: each would take two seconds to import the program."""
    address = f"\0lineside-tests-{RUN}"
    ours = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    while ours.connect_ex(address):
        _begin(address)
    atexit.register(ours.close)
    return ours


def _begin(address: str) -> None:
    """Start the fork server, unless another process does at this moment."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        try:
            listener.bind(address)
        except OSError:
            time.sleep(0.01)
            return
        listener.listen()
        process = subprocess.Popen([sys.executable, "-P", __file__], stdin=listener, cwd=ROOT)
        atexit.register(process.wait)


# --- in the server ---------------------------------------------------------------------------------


def serve(listener: socket.socket) -> Program | None:
    """Fork for each request and report its process id and exit code, until the last of the tests ends.
    Returns in each forked process, with its program."""
    selector = select_on(listener)
    connections = 0
    while True:
        for key, _ in selector.select():
            if key.data is not None:
                selector.unregister(key.fileobj)
                _report_end(key.fileobj, *key.data)
            elif key.fileobj is listener:
                selector.register(listener.accept()[0], selectors.EVENT_READ)
                connections += 1
            elif (request := _request(key.fileobj)) is None:
                selector.unregister(key.fileobj)
                key.fileobj.close()
                connections -= 1
                if not connections:
                    return None
            elif program := _fork(selector, *request):
                return program


def _request(connection: Any) -> tuple[bytes, list[int]] | None:
    """The next one with its descriptors; None after the last."""
    message, descriptors, *_ = socket.recv_fds(connection, MAX_BYTES, 4)
    return (message, descriptors) if message else None


def _fork(selector: selectors.BaseSelector, message: bytes, descriptors: list[int]) -> Program | None:
    """In the server None; in the forked process its program."""
    *streams, status = descriptors
    pid = os.fork()
    if pid == 0:
        selector.close()
        return _become(json.loads(message), streams)
    os.write(status, REPORT.pack(pid))
    for stream in streams:
        os.close(stream)
    selector.register(os.pidfd_open(pid), selectors.EVENT_READ, (pid, status))
    return None


def _report_end(pidfd: Any, pid: int, status: int) -> None:
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    with suppress(BrokenPipeError):  # the tests no longer wait for it
        os.write(status, REPORT.pack(code))
    os.close(status)
    os.close(pidfd)


def _become(request: Mapping[str, Any], streams: list[int]) -> Program:
    """Make this process what the request describes; its program."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    os.chdir(request["folder"])
    if request["umask"] >= 0:
        os.umask(request["umask"])
    os.environ.clear()
    os.environ.update(request["environment"])
    time.tzset()
    tempfile.tempdir = None
    if request["forks_workers"]:
        asyncio.create_subprocess_exec = partial(fork_if_worker, asyncio.create_subprocess_exec)
    program: Program = request["program"]
    sys.argv = [ENTRY_POINTS[program][1], *request["words"]]
    sys.orig_argv = [sys.executable, *sys.argv]
    return program


# --- in a forked server ----------------------------------------------------------------------------


async def fork_if_worker(start_process: Callable[..., Any], *words: str, **options: Any) -> Any:
    """Fork a bus worker where the server would start one, which takes half a second to import what the server
    has imported; start any other process. The worker uses nothing that a thread of the server may hold."""
    if words[1:4] != ("-P", "-m", "bus"):
        return await start_process(*words, **options)
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        with suppress(BaseException):
            os._exit(run_worker(words[4:], reading, options["env"]))
        os._exit(1)
    os.close(reading)
    return ForkedWorker(pid, os.fdopen(writing, "wb", buffering=0))


def run_worker(words: Sequence[str], token: int, environment: Mapping[str, str]) -> int:
    """Run a worker in a process that was forked from a server; its exit code."""
    run_at_once()
    signal.set_wakeup_fd(-1)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)
    os.setpgrp()
    os.dup2(token, 0)
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    os.environ.clear()
    os.environ.update(environment)
    code: int = import_module("bus.__main__").main(list(words))
    return code


class ForkedWorker:
    """A worker as the server sees it, in place of `asyncio.subprocess.Process`."""

    def __init__(self, pid: int, stdin: IO[bytes]) -> None:
        self.pid, self.stdin = pid, stdin
        self.returncode: int | None = None
        self._ended = asyncio.Event()
        self._pidfd = os.pidfd_open(pid)
        asyncio.get_running_loop().add_reader(self._pidfd, self._end)

    def _end(self) -> None:
        asyncio.get_running_loop().remove_reader(self._pidfd)
        os.close(self._pidfd)
        self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        self._ended.set()

    async def wait(self) -> int:
        """The exit code, minus the signal that ended it."""
        await self._ended.wait()
        assert self.returncode is not None
        return self.returncode

    def terminate(self) -> None:
        """By SIGTERM."""
        os.kill(self.pid, signal.SIGTERM)

    def kill(self) -> None:
        """By SIGKILL."""
        os.kill(self.pid, signal.SIGKILL)


# --- before the first fork -------------------------------------------------------------------------


def compile_catalogs_once() -> None:
    """Every site has a folder for them, in which its first start would compile all catalogs again."""
    languages = import_module("app.core.messages.languages")
    languages._parsed = cache(languages._parsed)
    for path in languages.catalogs().values():
        languages._parsed(path.read_bytes(), path.stem)


def prepare_pages() -> None:
    """Each server would analyze its routes, compile its templates and pack its static files again: that takes
    longer than to start it."""
    made_once = import_module("tests.made_once")
    made_once.Environment.compile = made_once.compiling_once()
    made_once.api.get_openapi = made_once.describing_once()
    assets_class = made_once.Assets
    assets_class.__init__ = made_once.reading_once()
    assets = assets_class(made_once.static_dir())
    for name in assets:
        assets.get(name).pack()
    for feature in import_module("app.main").FEATURES:
        for route in (route for router in feature.routers for route in router.routes):
            assert route.dependant


def main() -> None:
    """Serve, and run the program in a forked process: it returns to the interpreter, whose end is that of
    any program."""
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    for module in (*IMPORTED, *(module for module, _ in ENTRY_POINTS.values())):
        import_module(module)
    compile_catalogs_once()
    prepare_pages()
    gc.collect()
    gc.freeze()
    listener = socket.socket(fileno=os.dup(sys.stdin.fileno()))
    if program := serve(listener):
        sys.exit(import_module(ENTRY_POINTS[program][0]).main())


if __name__ == "__main__":
    main()
