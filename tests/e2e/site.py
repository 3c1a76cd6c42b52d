"""A complete plant for a test: simulated units at a port, ``lineside serve`` on them, and users of each role.

Each part is a separate process and communicates as on a machine: a device path, HTTP, the command. They are
forked (`tests.fork_server`).
"""

from __future__ import annotations

import atexit
import json
import os
import shutil
import signal
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from itertools import product
from pathlib import Path
from tempfile import mkdtemp
from typing import IO, Any

import httpx

from app.cli.accounts import with_accounts
from app.core.web.access import Role
from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.templating import Templates
from app.people.auth.accounts import Accounts
from app.settings import Site as SiteSettings
from bus.catalogue import parameters as numbers
from bus.simulator.plant import demo_line
from tests import fork_server
from tests.administrator import BY
from tests.e2e.limits import CALL_S, COMMAND_S, START_S, UNIT_S
from tests.fork_server import ForkedProcess
from tests.free_port import free_port
from tests.simulator_remote import Remote

LINESIDE = Path(sys.executable).with_name("lineside")
ROLES = ("viewer", "operator", "engineer", "admin")
PASSWORD = "collect house bakery stable"
AT_REST = ("--no-script", "--no-unrest", "--turnaround-ms", "50")
"""Units to which nothing happens but what the test does. They respond later than drives do, so that the
processes of a line, which poll all the time, do a third of what they would."""

WRITES = (0x82, 0x83, 0x84, 0x86, 0x87, 0x88)
"""The commands that change something."""
NO_TENSION_ALARM = """
[[built_in_alarm]]
code = "analog_out_of_limits"
above_percent = 100
below_percent = 0
"""
"""A section beside one that is stopped pulls the web taut, sooner or later."""

ONE_REQUEST = httpx.Limits(max_keepalive_connections=0)
"""For each connection of a client: the server closes one that is idle, maybe as the next request is sent."""


def eventually(condition: Callable[[], Any], what: str, *, within: float = UNIT_S) -> Any:
    """The first true result of ``condition``; fails with ``what`` when there is none in time."""
    end, pause = time.monotonic() + within, 0.02
    while time.monotonic() < end:
        result = condition()
        if result:
            return result
        # A call of the API is 15 ms of work: who waits long, asks less often.
        time.sleep(pause)
        pause = min(pause * 1.5, 0.3)
    raise AssertionError(f"not within {within:g} s: {what}")


@dataclass
class Line:
    """A process of simulated units. ``port`` is the value for lineside.toml, ``remote`` operates the
    units.
    """

    port: str
    remote: Remote
    process: ForkedProcess

    @contextmanager
    def stopped(self, unit: int) -> Iterator[None]:
        """Hold a unit in emergency stop."""
        self.remote.do("input", unit=unit, input="estop", on=True)
        try:
            yield
        finally:
            self.remote.do("input", unit=unit, input="estop", on=False)

    def close(self) -> None:
        """Power off."""
        self.remote.close()
        end(self.process)


def start_line(folder: Path, units: int, *options: str, name: str = "line") -> Line:
    """``lineside simulate`` behind a path that stays when the cable is pulled and plugged again."""
    link = folder / f"tty-{name}"
    called = ("simulate", "--units", str(units), "--link", link, "--control", "0", *options)
    process = fork_server.start(*called, stdout=subprocess.PIPE)
    assert process.stdout is not None
    fork_server.run_at_once(process.pid)
    port = process.stdout.readline().strip()
    control = process.stdout.readline().rpartition(":")[2]
    assert control, "lineside simulate did not start; its error output stands above"
    return Line(port, Remote(int(control)), process)


def run_in_time(process: ForkedProcess | subprocess.Popen[Any]) -> None:
    """A server has its own machine, whatever the load of this one: a page removes its controls after two
    seconds without response.
    """
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, process.pid, -10)


def end(process: ForkedProcess | subprocess.Popen[Any], number: int = signal.SIGTERM) -> int:
    """Send a signal and wait; what the process returned."""
    if process.poll() is None:
        process.send_signal(number)
    status = process.wait(timeout=START_S)
    if process.stdout is not None:
        process.stdout.close()
    return status


def command(config: Path, *arguments: str, text: str = "") -> str:
    """Run ``lineside …`` with ``text`` on its standard input; its output."""
    done = fork_server.run(*arguments, "--config", config, text=text)
    assert done.returncode == 0, done.stderr
    return done.stdout


@cache
def people() -> tuple[Path, dict[str, str]]:
    """Return the data of a new site with one user and one token for each role, and the tokens. Made once,
    copied for every site. Templates and catalogs are compiled, too, which otherwise each server repeats.
    """
    folder = Path(mkdtemp(prefix="lineside-people-"))
    atexit.register(shutil.rmtree, folder)
    config = folder / "lineside.toml"
    config.write_text('[server]\ndata = "./data"\n')
    tokens = add_people(config)
    templates = Templates(
        templates_dir(), Assets(static_dir()), SiteSettings(), kept_in=folder / "data" / "compiled"
    )
    environment = templates.environment("en")
    for name in environment.list_templates():
        environment.get_template(name)
    for language in templates.languages:
        language.term("Line")
    return folder / "data", tokens


def add_people(config: Path) -> dict[str, str]:
    """Add one user and one token for each role to the store of a site; the tokens."""
    # Playwright runs an event loop in the thread of the test.
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(with_accounts, config, _add_all_roles).result()


async def _add_all_roles(accounts: Accounts) -> dict[str, str]:
    for role in ROLES:
        await accounts.add_user(role, Role(role), PASSWORD, **BY)
    return {role: await accounts.create_token(f"{role}-program", Role(role), **BY) for role in ROLES}


@dataclass
class Site:
    """A served line. ``url`` is constant for the life of the site, also when the server is restarted.
    ``more``: other buses by name, each with its units. ``installed``: the server is a new process of the
    installed command, as benchmarks measure it.
    """

    folder: Path
    line: Line
    url: str
    units: int
    more: dict[str, tuple[Line, int]] = field(default_factory=dict)
    tokens: dict[str, str] = field(default_factory=dict)
    sessions: dict[str, Any] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    installed: bool = False
    certificate: ssl.SSLContext | None = None
    """Trusts that of the server, where it serves HTTPS."""
    server: ForkedProcess | subprocess.Popen[bytes] | None = None
    log: IO[bytes] | None = None

    @property
    def config(self) -> Path:
        """Its lineside.toml."""
        return self.folder / "lineside.toml"

    def last_logged(self) -> str:
        """The end of what the server has logged."""
        return (self.folder / "serve.log").read_text(encoding="utf-8", errors="replace")[-4000:]

    def configure(self, toml: str = "", turnaround_ms: int = 500) -> None:
        """Write its lineside.toml."""
        self.config.write_text(_configuration(self, toml, turnaround_ms), encoding="utf-8")

    def start(self) -> None:
        """Start ``lineside serve`` and wait until it responds."""
        self.log = (self.folder / "serve.log").open("ab")
        environment = {**os.environ, **self.environment}
        called = ("serve", "--config", str(self.config))
        if self.installed:
            self.server = subprocess.Popen(
                [LINESIDE, *called], stdout=self.log, stderr=self.log, env=environment
            )
        else:
            self.server = fork_server.start(*called, stdout=self.log, stderr=self.log, env=environment)
        run_in_time(self.server)
        wait_until_it_serves(self.server, self.folder / "serve.log", self._responds)

    def wait_for_units(self) -> None:
        """Until every unit has been read, and its decimals are known: of many, one after the other."""
        eventually(self._all_read, "a reading from every unit", within=max(START_S, 2.0 * self.units))

    def writes(self) -> list[str]:
        """Every request that writes, as the units of ``line`` received it."""
        entries: list[dict[str, Any]] = self.line.remote.do("record", kinds=["received"])
        return [entry["hex"] for entry in entries if bytes.fromhex(entry["hex"])[1] in WRITES]

    def acknowledge_all(self) -> None:
        """Acknowledge every alarm that there is."""
        with self.api() as client:
            for alarm in client.get("/alarms").json()["alarms"]:
                client.post(f"/alarms/{alarm['id']}/acknowledge")

    def end_alarms(self, of: str = "") -> None:
        """Wait until no alarm whose id begins with ``of`` is active, and leave none to acknowledge."""
        with self.api() as client:
            active: set[str] = set()

            def are_over() -> bool:
                active.clear()
                found = client.get("/alarms").json()["alarms"]
                active.update(each["id"] for each in found if each["active"] and each["id"].startswith(of))
                return not active

            try:
                eventually(are_over, "the end of every alarm")
            except AssertionError as failure:
                raise AssertionError(f"{failure}: {sorted(active)}") from None
        self.acknowledge_all()

    def stop(self, number: int = signal.SIGTERM) -> int:
        """End the server by a signal; what it returned."""
        assert self.server is not None
        assert self.log is not None
        status = end(self.server, number)
        self.log.close()
        self.server = None
        return status

    def close(self) -> None:
        """Stop everything."""
        if self.server is not None:
            self.stop()
        for line in (self.line, *(other for other, _ in self.more.values())):
            line.close()

    def command(self, *arguments: str, text: str = "") -> str:
        """Run ``lineside …`` on this configuration; its output."""
        return command(self.config, *arguments, text=text)

    def add_people(self) -> None:
        """One user and one token for each role, under the role's name; before the first start."""
        files, tokens = people()
        shutil.copytree(files, self.folder / "data", dirs_exist_ok=True)
        self.tokens = dict(tokens)

    def api(self, role: str | None = "admin") -> httpx.Client:
        """Return a client of the API with a role's token (None: anonymous)."""
        headers = {"Authorization": f"Bearer {self.tokens[role]}"} if role else {}
        url = f"{self.url}/api/v1"
        # Loading certificates takes longer than a call.
        return httpx.Client(
            base_url=url,
            headers=headers,
            timeout=CALL_S,
            limits=ONE_REQUEST,
            trust_env=False,
            verify=False,
        )

    def unit(self, number: int = 1, bus: str = "line") -> dict[str, Any]:
        """A unit as the API shows it now."""
        with self.api() as client:
            shown: dict[str, Any] = client.get(f"/buses/{bus}/units/{number}").json()
            return shown

    def set_speed(self, unit: int, *, bus: str = "line", **body: Any) -> None:
        """An operator sets the speed of a unit by the API, on a busy machine too: what a test begins with."""
        with self.api("operator") as client:
            response = client.post(f"/buses/{bus}/units/{unit}/speed", json={"timeout_s": COMMAND_S, **body})
        assert response.status_code == 200, response.text

    def _responds(self) -> bool:
        # A light client: it polls fifty times a second while the server starts, and that is measured.
        address, tls = self.url.rpartition("/")[2], self.certificate
        connection = (
            HTTPSConnection(address, timeout=START_S, context=tls)
            if tls
            else HTTPConnection(address, timeout=START_S)
        )
        try:
            connection.request("GET", "/healthz")
            return connection.getresponse().status == 200
        except (OSError, HTTPException):
            return False
        finally:
            connection.close()

    def _all_read(self) -> bool:
        with self.api() as client:
            units = [unit for bus in client.get("/line").json()["buses"] for unit in bus["units"]]
        return all(unit["link"] == "online" and unit["decimals"] is not None for unit in units)


@contextmanager
def site(
    folder: Path,
    units: int = 8,
    *,
    port: int | None = None,
    line_options: tuple[str, ...] = (),
    toml: str = "",
    turnaround_ms: int = 500,
    ramp_s: float | None = None,
    more: dict[str, int] | None = None,
    environment: dict[str, str] | None = None,
    installed: bool = False,
    certificate: Path | None = None,
) -> Iterator[Site]:
    """Run a site of ``units`` on the bus ``line``; ``toml`` is added to its file. ``more``: further buses,
    each by name with its number of units. ``turnaround_ms``: how long to wait for a response; the simulated
    units are a process, which a busy machine may delay. ``ramp_s``: of each unit on ``line``, not 20 s.
    ``environment``: more variables of the server's environment. ``certificate``: serve HTTPS with
    ``server.pem`` of this folder, which has its authority.
    """
    scheme = "http" if certificate is None else "https"
    url = f"{scheme}://127.0.0.1:{port or free_port()}"
    made = Site(folder, start_line(folder, units, *line_options), url, units)
    if certificate is not None:
        made.certificate = ssl.create_default_context(cafile=certificate / "ca.pem")
        files = {"certificate": certificate / "server.pem", "key": certificate / "server.key"}
        toml += "[server.tls]\n" + "".join(f'{key} = "{file}"\n' for key, file in files.items())
    try:
        for name, count in (more or {}).items():
            made.more[name] = (start_line(folder, count, *line_options, name=name), count)
        if ramp_s is not None:
            for unit, number in product(range(1, units + 1), (numbers.ACCELERATION, numbers.DECELERATION)):
                made.line.remote.do("parameter", unit=unit, number=number, raw=round(ramp_s * 10))
        made.configure(toml, turnaround_ms)
        made.environment = environment or {}
        made.installed = installed
        made.add_people()
        made.start()
        made.wait_for_units()
        yield made
    finally:
        made.close()


def wait_until_it_serves(
    server: ForkedProcess | subprocess.Popen[Any], log: Path, serves: Callable[[], bool]
) -> None:
    """Wait until a server serves. Fails with the end of its log; at once when it has ended."""

    def look() -> bool:
        assert server.poll() is None, "lineside serve ended"
        return serves()

    try:
        eventually(look, "a response of the server", within=START_S)
    except AssertionError as failure:
        raise AssertionError(f"{failure}:\n{log.read_text()[-4000:]}") from None


def _configuration(made: Site, toml: str, turnaround_ms: int) -> str:
    port = made.url.rpartition(":")[2]
    head = f"""\
[server]
port = {port}
data = "./data"

{toml}
"""
    lines = {"line": (made.line, made.units)} | made.more
    return head + "".join(
        f"""
[[bus]]
name = {json.dumps(name)}
port = {json.dumps(line.port)}
turnaround_ms = {turnaround_ms}
{unit_tables(units)}"""
        for name, (line, units) in lines.items()
    )


def unit_tables(units: int) -> str:
    """The demo's units as they stand in lineside.toml."""
    return "".join(_unit_table(unit) for unit in demo_line(units).settings)


def _unit_table(unit: Any) -> str:
    outputs = "".join(
        f"output.{number} = {json.dumps(name)}\n" for number, name in unit.labels.output.items()
    )
    return (
        f"\n[[bus.unit]]\nid = {unit.id}\nname = {json.dumps(unit.name)}\ngroup = {json.dumps(unit.group)}\n"
        f"[bus.unit.labels]\n{outputs}analog = {json.dumps(unit.labels.analog)}\n"
        f"analog_unit = {json.dumps(unit.labels.analog_unit)}\nunit = {json.dumps(unit.labels.unit)}\n"
    )
