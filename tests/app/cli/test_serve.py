"""``lineside serve`` and ``lineside demo`` as processes: they start, restart what dies, and end
completely.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner, Result
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from app.cli import cli, hosting
from app.cli.demo import CHOOSE
from app.cli.hosting import MAX_MISSED, MAX_MISSED_AT_START, HostingError, Watchdog, only_one
from app.cli.starting import NEXT_PORTS, ListenError, listen, listen_from
from app.core.database import Database
from app.core.server.service_manager import ServiceManager
from app.settings import load
from bus.instants import monotonic_now
from tests import fork_server
from tests.e2e.site import eventually
from tests.for_each import for_each
from tests.fork_server import ForkedProcess
from tests.sizes import sizes

ROOT = Path(__file__).resolve().parents[3]
LINESIDE = Path(sys.executable).with_name("lineside")
PATIENCE_S = 60.0
"""This machine may be busy; nothing here is a measurement."""
Process = subprocess.Popen[str] | ForkedProcess
CONFIG = """\
[server]
port = 0
[[bus]]
name = "dry-end"
port = "{port}"
[[bus.unit]]
id = 1
name = "Unwind"
"""


def children_of(pid: int) -> list[int]:
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid and fields[0] != "Z":
            found.append(int(status.parent.name))
    return sorted(found)


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@contextmanager
def started(*words: str, as_installed: bool = False, **options: Any) -> Iterator[tuple[Process, str]]:
    """The process and the URL that it prints. ``as_installed``: by the command; otherwise it is forked, with
    the ``options`` of `fork_server.start`."""
    process: Process
    if as_installed:
        process = subprocess.Popen([LINESIDE, *words], stdout=subprocess.PIPE, text=True)
    else:
        process = fork_server.start(*words, stdout=subprocess.PIPE, **options)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        url = re.search(r"http://127\.0\.0\.1:\d+", line)
        assert url, f"no URL in {line!r}"
        yield process, url[0]
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "lineside.toml"
    path.write_text(CONFIG.format(port=tmp_path / "absent"))
    return path


def is_serving(url: str) -> bool:
    return httpx.get(f"{url}/healthz", trust_env=False, timeout=PATIENCE_S).json() == {"status": "ok"}


def only_child(process: Process) -> int:
    return int(eventually(lambda: children_of(process.pid), "a worker runs")[0])


@pytest.mark.parametrize(
    ("number", "within_s"),
    [(signal.SIGINT, PATIENCE_S), pytest.param(signal.SIGTERM, 5.0, marks=pytest.mark.soak)],
)
def test_it_ends_completely_also_with_an_open_page(config: Path, number: int, within_s: float) -> None:
    """The installed command does by SIGTERM in `tests.app.system.test_configuration_restart`."""
    token = viewer_token(config)
    with started("serve", "--config", str(config)) as (process, url):
        assert is_serving(url)
        worker = only_child(process)
        headers = {"Authorization": f"Bearer {token}"}
        address = url.replace("http", "ws", 1) + "/live"
        with connect(address, additional_headers=headers, proxy=None) as page:
            assert "snapshot" in str(page.recv())
            process.send_signal(number)
            assert process.wait(timeout=within_s) == 0
            with pytest.raises(ConnectionClosed):
                read_to_the_end(page)
        assert not is_alive(worker)
    assert command("audit", "verify", config=config).exit_code == 0


def command(*words: str, config: Path) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(cli, [*words, "--config", str(config)])


def viewer_token(config: Path) -> str:
    return command("token", "create", "t", "--role", "viewer", config=config).stdout.strip()


def test_a_stop_does_not_wait_for_the_code_that_is_still_read(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    happened: list[str] = []
    has_ended = threading.Event()

    class Workers:
        def __init__(self, *_: object, **__: object) -> None: ...

        def start_all(self) -> None: ...

        async def stop_all(self) -> None:
            happened.append("workers ended")

    def import_module(_: str) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        happened.append("host ended" if has_ended.wait(PATIENCE_S) else "host waits")

    monkeypatch.setattr(hosting, "WorkerProcesses", Workers)
    monkeypatch.setattr(hosting, "import_module", import_module)
    monkeypatch.setattr(hosting, "configure_log", lambda: None)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        hosting.host(load(config), config, listening, ServiceManager({}), monotonic_now())
    assert happened == ["workers ended"]
    has_ended.set()
    eventually(lambda: happened == ["workers ended", "host ended"], "the thread of the import ends")


def read_to_the_end(page: ClientConnection) -> None:
    while True:
        page.recv()


def test_a_worker_that_dies_is_started_again_and_none_outlives_a_killed_parent(config: Path) -> None:
    with started("serve", "--config", str(config)) as (process, url):
        first = only_child(process)
        os.kill(first, signal.SIGKILL)
        second = eventually(
            lambda: [pid for pid in children_of(process.pid) if pid != first], "another worker runs"
        )
        assert is_serving(url)
        assert second != [first]
        process.kill()
        process.wait()
        eventually(lambda: not any(map(is_alive, second)), "the worker ends too")


def buses_at(url: str, token: str) -> Any:
    headers = {"Authorization": f"Bearer {token}"}
    line = httpx.get(f"{url}/api/v1/line", headers=headers, trust_env=False, timeout=PATIENCE_S)
    return line.json()["buses"]


@pytest.mark.soak
def test_a_worker_that_is_frozen_is_replaced(config: Path) -> None:
    token = viewer_token(config)
    with started("serve", "--config", str(config)) as (process, url):

        def is_linked() -> bool:
            return bool(buses_at(url, token)[0]["worker"])

        eventually(is_linked, "the worker is linked")
        frozen = only_child(process)
        os.kill(frozen, signal.SIGSTOP)
        eventually(lambda: not is_alive(frozen), "the frozen worker is killed")
        eventually(lambda: children_of(process.pid) not in ([], [frozen]), "another worker runs")
        eventually(is_linked, "it is linked")


def test_the_app_knows_its_worker_reports_the_missing_port_and_shares_its_data_with_no_other(
    config: Path,
) -> None:
    token = viewer_token(config)
    with started("serve", "--config", str(config), forks_workers=False) as (process, url):
        eventually(lambda: buses_at(url, token)[0]["worker"], "the worker is linked")
        eventually(lambda: "absent" in buses_at(url, token)[0]["link_cause"]["detail"], "it names the port")
        assert buses_at(url, token)[0]["link"] == "closed"
        harmless = {"LINESIDE_PARENT", "PYDANTIC_DISABLE_PLUGINS", "COLUMNS", "LINES"}
        assert shown_by_ps(only_child(process)) <= harmless
        other = fork_server.run("serve", "--config", config)
    assert other.returncode == 1
    assert "another Lineside server uses" in other.stderr


def shown_by_ps(pid: int) -> set[str]:
    """The variables that a listing shows of a worker, beyond those of this test."""
    shown = Path(f"/proc/{pid}/environ").read_text().split("\0")
    arguments = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
    assert {each for each in arguments if each.startswith("--")} == {"--config", "--bus", "--app", "--child"}
    return {each.partition("=")[0] for each in shown} - os.environ.keys() - {""}


def test_a_busy_port_prints_one_line_and_exits_with_1(config: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        config.write_text(config.read_text().replace("port = 0", f"port = {port}"))
        done = command("serve", config=config)
    assert (done.exit_code, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert f"port {port} of 127.0.0.1 is in use by another program" in done.stderr
    assert f"set port in [server] of {config}" in done.stderr


def test_a_demo_on_a_busy_port_names_its_option() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = CliRunner().invoke(cli, ["demo", "--port", port])
        # These tests may run under another make, which passes its options down.
        environment = {name: value for name, value in os.environ.items() if name != "MAKEFLAGS"}
        make = ["make", "--no-print-directory", "demo"]
        made, wrong = (
            subprocess.run([*make, f"PORT={each}"], capture_output=True, text=True, cwd=ROOT, env=environment)
            for each in (port, "80x")
        )
    assert (done.exit_code, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert "lineside demo --port 8100, or make demo PORT=8100" in done.stderr
    assert made.returncode != 0
    assert made.stderr.startswith(f"Port {port} is in use."), "before everything else that make would do"
    assert "make demo PORT=8100" in made.stderr
    assert wrong.returncode != 0
    assert wrong.stderr.startswith("PORT=80x is no number")


def test_a_demo_without_a_port_takes_the_next_that_is_free() -> None:
    with listen("127.0.0.1", 0, CHOOSE) as taken:
        first = taken.getsockname()[1]
        with listen_from("127.0.0.1", first, CHOOSE) as found:
            assert first < found.getsockname()[1] <= first + NEXT_PORTS
    with pytest.raises(ListenError, match="no address of this machine"):
        listen_from("192.0.2.1", first, CHOOSE)


@for_each(
    ("host", "words"), [("192.0.2.1", "is no address of this machine"), ("a..b", "there is no host 'a..b'")]
)
def test_an_impossible_address_is_reported(host: str, words: str) -> None:
    with pytest.raises(ListenError, match=words):
        listen(host, 0, "choose another")


def test_a_service_that_cannot_start_is_named_in_one_line(config: Path) -> None:
    store = load(config).server.store
    Database(store).close()
    with closing(sqlite3.connect(store)) as connection:
        connection.execute("ALTER TABLE swap RENAME TO lost")
    done = fork_server.run("serve", "--config", config)
    assert (done.returncode, done.stdout) == (1, "")
    reason = "lineside: the dashboard could not start: swaps: "
    assert done.stderr.splitlines()[-1].startswith(reason)
    assert "Traceback" not in done.stderr
    with closing(sqlite3.connect(store)) as connection:
        (last,) = connection.execute("SELECT what FROM events ORDER BY id DESC LIMIT 1").fetchone()
    assert last == "server stopped"


def test_a_folder_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("no folder")
    with pytest.raises(HostingError, match="File exists; give the server"):
        only_one(tmp_path / "data").__enter__()


def test_a_store_that_is_missing_is_not_replaced(config: Path, tmp_path: Path) -> None:
    command("audit", "rotate-key", config=config)  # makes the store
    former = (tmp_path / "lineside.audit.key").read_bytes()
    (tmp_path / "data").rename(tmp_path / "unmounted")
    for words in (("serve",), ("user", "list"), ("audit", "rotate-key")):
        done = command(*words, config=config)
        assert (done.exit_code, done.stdout, done.stderr.count("\n")) == (1, "", 1)
        assert f"the store {tmp_path / 'data' / 'lineside.db'} is missing" in done.stderr
        assert "lineside serve --new" in done.stderr
    assert not (tmp_path / "data").exists()
    assert (tmp_path / "lineside.audit.key").read_bytes() == former


@pytest.mark.parametrize(
    "content", sizes(b"", None, b"no store " * 1000), ids=["empty", "missing", "damaged"]
)
def test_a_new_site_is_begun_by_command_and_recorded(
    config: Path, tmp_path: Path, content: bytes | None
) -> None:
    store = tmp_path / "data" / "lineside.db"
    command("audit", "rotate-key", config=config)  # makes the store
    there = command("serve", "--new", config=config)
    assert (there.exit_code, there.stderr.count("\n")) == (1, 1)
    assert "holds a site" in there.stderr
    store.unlink()
    if content is not None:
        store.write_bytes(content)
    with started("serve", "--new", "--config", str(config)) as (_, url):
        assert is_serving(url)
    assert command("audit", "verify", config=config).exit_code == 0
    with closing(sqlite3.connect(store)) as connection:
        [(first, _), *_] = connection.execute("SELECT what, id FROM events ORDER BY id").fetchall()
    assert "new site begun with --new" in first
    assert len(list(tmp_path.glob("lineside.audit.key.before-*"))) == 1
    kept = [path.read_bytes() for path in store.parent.glob("lineside.db.damaged-*")]
    assert kept == ([content] if content else [])


def test_a_new_site_does_not_begin_with_the_anchor_of_the_former(config: Path, tmp_path: Path) -> None:
    config.write_text(config.read_text() + '[audit]\nanchor = "./worm.anchor"\n')
    command("audit", "rotate-key", config=config)  # makes the store
    (tmp_path / "worm.anchor").write_text("of the former site")
    (tmp_path / "data" / "lineside.db").unlink()
    verified = command("audit", "verify", config=config)
    assert (verified.exit_code, "lineside serve --new" in verified.stderr) == (1, True)
    done = command("serve", "--new", config=config)
    assert (done.exit_code, done.stderr.count("\n")) == (1, 1)
    assert "is of the former site" in done.stderr
    assert (tmp_path / "worm.anchor").read_text() == "of the former site"
    assert not (tmp_path / "data" / "lineside.db").exists()


def test_the_demo_shows_a_line_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with started("demo", "--units", "3", "--port", "0") as (process, url):

        def line() -> Any:
            return httpx.get(f"{url}/api/v1/line", trust_env=False, timeout=PATIENCE_S).json()

        units = eventually(
            lambda: [unit for unit in line()["buses"][0]["units"] if unit["link"] == "online"][2:], "3 units"
        )
        assert units[0]["id"] == 3
        page = httpx.get(f"{url}/", trust_env=False, timeout=PATIENCE_S)
        assert (page.status_code, "SIMULATED" in page.text) == (200, True)
        assert list(tmp_path.iterdir())
        pids = children_of(process.pid)
        assert len(pids) == 2
        process.terminate()
        assert process.wait(timeout=PATIENCE_S) == 0
        assert not any(is_alive(pid) for pid in pids)
        assert list(tmp_path.iterdir()) == []


def test_nothing_of_a_killed_demo_lives_on() -> None:
    with started("demo", "--units", "1", "--port", "0") as (process, _):
        pids = eventually(lambda: children_of(process.pid)[1:] and children_of(process.pid), "both run")
        process.kill()
        process.wait()
        eventually(lambda: not any(is_alive(pid) for pid in pids), "both end too")


def looks_until_expired(watchdog: Watchdog) -> int:
    looks = 1
    while not watchdog.expires(responds=False):
        looks += 1
    return looks


def test_one_that_responded_is_given_up_after_its_limit() -> None:
    watchdog = Watchdog()
    assert not watchdog.expires(responds=True)
    assert not watchdog.expires(responds=True)
    assert looks_until_expired(watchdog) == MAX_MISSED


def test_every_response_begins_the_count_again() -> None:
    watchdog = Watchdog()
    for responds in (False, True) * MAX_MISSED_AT_START:
        assert not watchdog.expires(responds=responds)
    assert looks_until_expired(watchdog) == MAX_MISSED


def test_one_that_starts_has_longer() -> None:
    assert looks_until_expired(Watchdog()) == 1 + MAX_MISSED_AT_START


def test_a_response_at_the_first_look_may_be_of_the_one_before() -> None:
    watchdog = Watchdog()
    assert not watchdog.expires(responds=True)
    assert looks_until_expired(watchdog) == MAX_MISSED_AT_START
