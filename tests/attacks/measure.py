"""What others notice of an attack: ``python -m tests.attacks.measure [--tls] [NAME…]`` prints a table.

For each attack: the longest of a hundred waits (p99) of another client's ``/healthz`` and of an operator's
command, what the server's memory grew by, at most and a minute later, how many commands were written to a
unit late, and whether the bus worker kept its link. The attacker has a core of its own.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx

from app.core.database import Database
from app.people.audit.log import EventLog
from tests.attacks.attackers import ATTACKS
from tests.certificates import certificates
from tests.e2e.site import CALL_S, ONE_REQUEST, Site, site

SLOWEST_S = 0.25
SLOWEST_COMMAND_S = 0.5
MAX_GROWTH_MIB = 20.0
PROBE_EVERY_S = 0.05
SETTLE_S = 2.0
LATER_S = 60.0
LATE_S = 2.0
"""What a command may wait until it is sent (`timeout_s` of the API)."""
WARM_S = 1.0
EVENTS, CHUNK = 300_000, 5000
ROOT = Path(__file__).resolve().parents[2]
ELSEWHERE = "127.0.0.2"
"""An address of this machine that the attacker does not have. At the attacker's own, each new connection by
HTTPS waits for the handshakes that were begun before it."""
CORE = max(os.sched_getaffinity(0))
"""That of the attacker."""


@dataclass
class Waits:
    """How long each request of one kind took, seconds; what failed is as long as its limit."""

    taken: list[float] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    late: int = 0
    """How many were sent to a unit later than they may be after the system had the request."""

    @property
    def served(self) -> int:
        """How many requests got the response that is due."""
        return len(self.taken) - len(self.failed)

    @property
    def p99(self) -> float:
        """The wait that one in a hundred exceeds."""
        return sorted(self.taken)[max(0, math.ceil(len(self.taken) * 0.99) - 1)] if self.taken else math.inf


@dataclass
class Measured:
    """One attack as the others saw it."""

    attack: str
    health: Waits
    command: Waits
    growth_mib: float
    lasting_mib: float
    """What was left of it once the server had had time to settle."""
    links_lost: int
    after: float
    """How long ``/healthz`` took once the attacker had stopped, seconds."""

    @property
    def faults(self) -> list[str]:
        """Return the figures that are exceeded, as text."""
        found = [f"healthz: {fault}" for fault in self.health.failed[:3]]
        found += [f"command: {fault}" for fault in self.command.failed[:3]]
        found += ["the worker's link was lost"] * bool(self.links_lost)
        found += [f"{self.command.late} commands were sent late"] * bool(self.command.late)
        if self.lasting_mib > MAX_GROWTH_MIB:
            found.append(f"memory grew by {self.lasting_mib:.0f} MiB")
        return found

    @property
    def is_quick(self) -> bool:
        """Return whether no wait was longer than what others may notice."""
        is_served = max(self.health.p99, self.after) <= SLOWEST_S
        return is_served and self.command.p99 <= SLOWEST_COMMAND_S

    @property
    def row(self) -> str:
        """One line of the table."""
        times = "".join(f"{1000 * wait:9.0f}" for wait in (self.health.p99, self.command.p99, self.after))
        kept = "lost" if self.links_lost else "kept"
        counts = f"{len(self.command.taken):6}{self.command.late:6}"
        memory = f"{self.growth_mib:8.1f}{self.lasting_mib:8.1f}"
        return f"{self.attack:<40}{times}{counts}{memory}  {kept:<6}{'; '.join(self.faults)}"


HEADING = (
    f"{'attack':<40}{'healthz':>9}{'command':>9}{'after':>9}{'commands':>12}{'memory, +MiB':>16}  link\n"
    f"{'':<40}{'p99 ms':>9}{'p99 ms':>9}{'ms':>9}{'all':>6}{'late':>6}{'most':>8}{'later':>8}"
)


def measure(
    target: Site, attack: str, seconds: float, *, warm_s: float = WARM_S, settle_s: float = SETTLE_S
) -> Measured:
    """Attack the site for ``seconds``, and send the requests of other clients meanwhile."""
    assert target.server is not None
    health, command = Waits(), Waits()
    with operator_elsewhere(target) as client:
        calls = ((health_request(target), health), (commands(client, command), command))
        # The first requests of each kind load modules, templates and pages of the store, which is no growth.
        for call, _ in calls:
            probe(call, Waits(), after_s(warm_s))
        if warm_s:
            with attacking(target, attack, warm_s):
                pass
        before, lost = memory_mib(target.server.pid), links_lost(target)
        most = [before]
        with attacking(target, attack, seconds) as is_over:
            threads = [threading.Thread(target=probe, args=(call, waits, is_over)) for call, waits in calls]
            for thread in threads:
                thread.start()
            while not is_over():
                most.append(memory_mib(target.server.pid))
                time.sleep(0.1)
            for thread in threads:
                thread.join()
    begun = time.monotonic()
    health_request(target)()
    after = time.monotonic() - begun
    time.sleep(settle_s)
    lasting = memory_mib(target.server.pid) - before
    return Measured(attack, health, command, max(most) - before, lasting, links_lost(target) - lost, after)


def add_worker_token(target: Site) -> None:
    """What an attacker of the feed has stolen."""
    called = ("token", "create", "stolen", "--role", "worker", "--bus", "line")
    target.tokens["worker"] = target.command(*called).strip()


def after_s(seconds: float) -> Callable[[], bool]:
    """Whether so long has passed since now."""
    end = time.monotonic() + seconds
    return lambda: time.monotonic() >= end


@contextmanager
def attacking(target: Site, attack: str, seconds: float) -> Iterator[Callable[[], bool]]:
    """Run an attacker in a separate process; yield a function that returns whether it has ended."""
    command = [sys.executable, "-m", "tests.attacks.attackers", attack, target.url, str(seconds)]
    process = subprocess.Popen(
        [*command, str(CORE), json.dumps(target.tokens)], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    try:
        yield lambda: process.poll() is not None
        _, fields = process.communicate()
        assert process.returncode == 0, fields
    finally:
        process.kill()
        process.wait()


def probe(call: Callable[[], None], waits: Waits, is_over: Callable[[], bool]) -> None:
    """Repeat the call until the attack is over."""
    while not is_over():
        begun = time.monotonic()
        try:
            call()
        except (httpx.HTTPError, HTTPException, OSError, AssertionError) as error:
            waits.failed.append(f"{type(error).__name__} {error}".strip())
        waits.taken.append(time.monotonic() - begun)
        time.sleep(PROBE_EVERY_S)


def operator_elsewhere(target: Site) -> httpx.Client:
    """Return an operator's client of the API at another address, with a new connection for each request."""
    transport = httpx.HTTPTransport(verify=False, limits=ONE_REQUEST, local_address=ELSEWHERE)
    token = {"Authorization": f"Bearer {target.tokens['operator']}"}
    return httpx.Client(base_url=f"{target.url}/api/v1", headers=token, timeout=CALL_S, transport=transport)


def health_request(target: Site) -> Callable[[], None]:
    """Return a client without sign-in and at another address, with a new connection each time."""

    def call() -> None:
        # A light client: httpx would load all certificates first.
        address, tls = target.url.rpartition("/")[2], target.certificate
        connection = (
            HTTPSConnection(address, timeout=30, source_address=(ELSEWHERE, 0), context=tls)
            if tls
            else HTTPConnection(address, timeout=30, source_address=(ELSEWHERE, 0))
        )
        try:
            connection.request("GET", "/healthz")
            response = connection.getresponse().read()
        finally:
            connection.close()
        assert json.loads(response) == {"status": "ok"}, response

    return call


def commands(client: httpx.Client, waits: Waits) -> Callable[[], None]:
    """An operator who switches an output, each time to the other state; counts those that are sent late."""
    states = [True, False]

    def call() -> None:
        states.reverse()
        handed_over: dict[str, float] = {}
        # Before that, this client itself may have waited for its core.
        steps = {"trace": lambda step, _: handed_over.setdefault(step, time.time())}
        response = client.put("/buses/line/units/1/outputs/1", json={"on": states[0]}, extensions=steps)
        result = response.json()
        sent_at = result.get("sent_at")
        if sent_at:
            left_at = handed_over["http11.send_request_body.complete"]
            waits.late += datetime.fromisoformat(sent_at).timestamp() > left_at + LATE_S
        assert result.get("outcome") == "verified", response.text[:200]

    return call


def memory_mib(process: int) -> float:
    """Resident memory."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def links_lost(target: Site) -> int:
    """How often a bus worker was lost, by the events."""
    with target.api() as client:
        events: list[dict[str, Any]] = client.get("/events?kind=worker&limit=1000").json()["events"]
    return sum(event["new"] == "gone" for event in events)


def fill_the_log(target: Site, events: int) -> None:
    """Add the events of years while the server is stopped."""
    target.stop()
    database = Database(target.folder / "data" / "lineside.db", synchronous="NORMAL")
    # With an outcome: the server closes each open one on the disk, one by one, when it starts.
    fields = {"who": "operator", "origin": "page", "bus": "line", "what": "set speed", "outcome": "verified"}
    intents = [{**fields, "unit": number % 4 + 1, "new": f"{number}.0"} for number in range(CHUNK)]

    async def fill() -> None:
        for _ in range(events // CHUNK):
            await EventLog(database).intend_together(intents)

    try:
        asyncio.run(fill())
    finally:
        database.close()
    target.start()
    target.wait_for_units()


def main(names: list[str], *, tls: bool = False, seconds: float = 20.0) -> int:
    """Print the table; 1 where a figure is not kept."""
    print(HEADING, flush=True)
    faulty = 0
    cores = os.sched_getaffinity(0)
    # All that is started from here on leaves the attacker its core.
    os.sched_setaffinity(0, cores - {CORE} or cores)
    with TemporaryDirectory() as folder, TemporaryDirectory() as keys:
        made = certificates(Path(keys)) if tls else None
        with site(Path(folder), 4, certificate=made) as target:
            add_worker_token(target)
            fill_the_log(target, EVENTS)
            for name in names or ATTACKS:
                measured = measure(target, name, seconds, settle_s=LATER_S)
                faulty += bool(measured.faults) or not measured.is_quick
                print(measured.row, flush=True)
    return int(faulty > 0)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("names", nargs="*", metavar="NAME", help="Attacks; by default all.")
    arguments.add_argument("--tls", action="store_true", help="By HTTPS.")
    chosen = arguments.parse_args()
    sys.exit(main(chosen.names, tls=chosen.tls))
