"""A random walk of restores and of replaced units with faults, judged by what the unit saw."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from random import Random
from typing import Any

import httpx
import pytest

from tests.e2e.limits import PROCEDURE_S
from tests.e2e.site import eventually
from tests.path.dashboard import Dashboard, dashboard
from tests.path.independent_unit import FACTORY, LIST, Unit
from tests.path.restore_judge import WRITE, Seen, WatchedUnit, complaints, of_another, wrong_checksum
from tests.sizes import sizes

UNIT = 2
SWAP = f"/swap/dry-end/{UNIT}"
WRITABLE = sorted(set(LIST) - {8, 17, 18, 19, 20, 21, 27, 37})
"""All but the follower's mode, the address, the password, what ends the conversation, and the setpoints."""
PROVEN = "verified by a full read"


@dataclass
class Walk:
    """``others``: rows that others wrote since the restore began; ``tasks``: what is under way beside it."""

    plant: Dashboard
    unit: WatchedUnit
    random: Random
    beside: ThreadPoolExecutor
    others: list[tuple[int, int]] = field(default_factory=list)
    tasks: list[Future[Any]] = field(default_factory=list)

    def do(self, what: Callable[..., Any], *given: Any) -> None:
        """Beside the walk: the cable's own thread must not wait for the product."""
        self.tasks.append(self.beside.submit(what, *given))

    def wanted(self) -> dict[int, int]:
        """Some rows with other values than the unit has now."""
        numbers = self.random.sample(WRITABLE, self.random.randint(2, 6))
        rows = {number: self.random.randint(*LIST[number][1:]) for number in numbers}
        return {
            number: raw for number, raw in rows.items() if raw != self.unit.values[number]
        } or self.wanted()

    def plan(self, wanted: dict[int, int]) -> str:
        """The id of a reviewed restore of these rows."""
        rows = "".join(f"{number} = {{ raw = {raw} }}\n" for number, raw in wanted.items())
        document = (
            'format = "lineside parameter set"\nversion = 1\ntaken_at = 2026-01-01T00:00:00Z\n'
            f"[[unit]]\nid = {UNIT}\n[unit.parameters]\n{rows}"
        )
        path = f"/units/{UNIT}/restores"
        planned = self.plant.bus("POST", path, {"document": document}, "engineer")
        assert planned.status_code == 201, planned.text
        return str(planned.json()["id"])

    def run(self, restore: str, fault: Fault, at: int) -> dict[str, Any]:
        """Start it with ``fault`` at a write; it as it has ended, when nothing is under way any more."""
        hook = fault(self, restore)
        if hook is not None:
            self.unit.hooks[at] = hook
        started = self.plant.call("POST", f"/restores/{restore}/start", role="engineer")
        assert started.status_code == 202, started.text
        ended = eventually(lambda: self.ended(restore), f"restore {restore} ended", within=PROCEDURE_S)
        return dict(ended)

    def ended(self, restore: str) -> dict[str, Any] | None:
        shown: dict[str, Any] = self.plant.call("GET", f"/restores/{restore}", role="engineer").json()
        return None if shown["state"] in ("running", "proving") else shown

    def heal(self) -> None:
        """Let the fault end; the unit is online again, and has been read since."""
        for task in self.tasks:
            task.result(PROCEDURE_S)
        self.tasks.clear()
        self.others.clear()
        self.unit.heal()
        for _ in range(2):
            self.is_read_again(self.plant.unit(UNIT)["read_at"])

    def is_read_again(self, before: str) -> None:
        self.plant.see(
            UNIT, "read again", lambda shown: shown["link"] == "online" and shown["read_at"] != before
        )


Fault = Callable[[Walk, str], Callable[[], None] | None]


def no_fault(_walk: Walk, _restore: str) -> None:
    """Nothing happens."""


def worker_killed(walk: Walk, _restore: str) -> Callable[[], None]:
    (worker,) = walk.plant.workers()
    return lambda: os.kill(worker, signal.SIGKILL)


def port_lost(walk: Walk, _restore: str) -> Callable[[], None]:
    def pull() -> None:
        walk.plant.cable.pull()
        eventually(lambda: walk.plant.line()["link"] == "closed", "the bus closed")
        walk.plant.cable.plug()

    return lambda: walk.do(pull)


def switched_off(walk: Walk, _restore: str) -> Callable[[], None]:
    return lambda: setattr(walk.unit, "off", True)


def in_local(walk: Walk, _restore: str) -> Callable[[], None]:
    return lambda: setattr(walk.unit, "remote", False)


def replaced(walk: Walk, _restore: str) -> Callable[[], None]:
    return lambda: walk.unit.values.update({**FACTORY, 17: UNIT})


def set_at_the_panel(walk: Walk, _restore: str) -> Callable[[], None]:
    number = walk.random.choice(WRITABLE)
    return lambda: walk.unit.values.update({number: LIST[number][1]})


def forgetful(walk: Walk, _restore: str) -> Callable[[], None]:
    return lambda: walk.unit.forgets.update(walk.random.sample(WRITABLE, 20))


def deaf(walk: Walk, _restore: str) -> Callable[[], None]:
    return lambda: walk.unit.deaf_to.add(WRITE)


def mute(walk: Walk, _restore: str) -> Callable[[], None]:
    return lambda: walk.unit.mute_on.add(WRITE)


def mute_then_in_local(walk: Walk, _restore: str) -> Callable[[], None]:
    """The response of a write is lost, and its repetition is refused."""

    def lose(_reply: bytes) -> None:
        walk.unit.spoil = None
        walk.unit.remote = False

    return lambda: setattr(walk.unit, "spoil", lose)


def refusing(walk: Walk, _restore: str) -> Callable[[], None]:
    return lambda: walk.unit.refuses.update(walk.random.sample(WRITABLE, 20))


def spoilt(walk: Walk, _restore: str) -> Callable[[], None]:
    def spoil(reply: bytes) -> bytes | None:
        ways = (wrong_checksum, of_another, lambda _: None, lambda good: good * 2, lambda good: good)
        return walk.random.choice(ways)(reply)

    return lambda: setattr(walk.unit, "spoil", spoil)


def late(walk: Walk, _restore: str) -> Callable[[], None]:
    """Each reply comes in place of the next one."""
    held: list[bytes] = []

    def hold(reply: bytes) -> bytes:
        held.append(reply)
        return held.pop(0) if len(held) > 1 else b""

    return lambda: setattr(walk.unit, "spoil", hold)


def another_writes(walk: Walk, _restore: str) -> Callable[[], None]:
    number = walk.random.choice(WRITABLE)
    raw = walk.random.randint(*LIST[number][1:])
    walk.others.append((number, raw))
    path = f"/units/{UNIT}/parameters/{number}"
    return lambda: walk.do(walk.plant.bus, "PUT", path, {"raw": raw}, "admin")


def another_restores(walk: Walk, restore: str) -> Callable[[], None]:
    def start_twice() -> None:
        again = walk.plant.call("POST", f"/restores/{restore}/start", role="admin")
        assert again.status_code == 409, again.text

    return lambda: walk.do(start_twice)


def canceled(walk: Walk, restore: str) -> Callable[[], None]:
    return lambda: walk.do(walk.plant.call, "POST", f"/restores/{restore}/cancel", None, "admin")


FAULTS: tuple[Fault, ...] = (
    no_fault,
    worker_killed,
    port_lost,
    switched_off,
    in_local,
    replaced,
    set_at_the_panel,
    forgetful,
    deaf,
    mute,
    mute_then_in_local,
    refusing,
    spoilt,
    late,
    another_writes,
    another_restores,
    canceled,
)


def restored(walk: Walk, wanted: dict[int, int], restore: str, fault: Fault) -> dict[str, Any]:
    """Run one restore and judge it."""
    begun = len(walk.unit.seen)
    claimed = walk.run(restore, fault, walk.random.randint(1, len(wanted)))
    seen, others = walk.unit.seen[begun:], list(walk.others)
    walk.heal()
    after = [each for each in walk.unit.seen[begun + len(seen) :] if each.what != "read"]
    late_writes = [each for each in after if (each.number, each.raw) not in others]
    where = f"{fault.__name__}: {claimed}"
    assert complaints(claimed, wanted, seen, others) == [], where
    assert late_writes == [], where
    event = walk.plant.call("GET", f"/events?limit=1&kind=restore&unit={UNIT}&bus=dry-end").json()["events"][
        0
    ]
    assert event["outcome"] == claimed["state"], where
    commands = walk.plant.call("GET", f"/events?limit=50&kind=command&unit={UNIT}&bus=dry-end").json()[
        "events"
    ]
    assert all(each["outcome"] for each in commands), where
    return claimed


def restore_with(walk: Walk, fault: Fault) -> None:
    """A restore with a fault, and the same again without."""
    wanted = walk.wanted()
    restored(walk, wanted, walk.plan(wanted), fault)
    again = restored(walk, wanted, walk.plan(wanted), no_fault)
    assert again["state"] == "equal", again
    assert {number: walk.unit.values[number] for number in wanted} == wanted


def replacement_with(walk: Walk, fault: Fault) -> None:
    """Another unit takes the place of the unit, and is restored with a fault until it equals the set."""
    kept = walk.plant.bus("POST", "/sets", {"units": [UNIT]}, "engineer").json()["id"]
    of_set = {number: raw for number, raw in walk.unit.values.items() if number in WRITABLE}
    begun = page(walk, "POST", SWAP, data={"source": f"set:{kept}:{UNIT}"})
    assert begun.status_code == 303, begun.text
    walk.unit.off = True
    eventually(
        lambda: "No spare responds yet" in page(walk, "GET", f"{SWAP}/look").text, "the place is empty"
    )
    spare = {number: walk.random.randint(*LIST[number][1:]) for number in WRITABLE}
    walk.unit.values.update(spare)
    walk.unit.off = False
    walk.plant.see(UNIT, "online", lambda shown: shown["link"] == "online")
    decoy = {6: walk.unit.values[6] ^ 1}
    assert restored(walk, decoy, walk.plan(decoy), no_fault)["state"] == "equal"
    for each in (fault, no_fault):
        assert PROVEN not in page(walk, "GET", f"{SWAP}/look").text
        planned = page(walk, "POST", f"{SWAP}/restore")
        assert planned.status_code == 303, planned.text
        claimed = restored(walk, of_set, planned.headers["location"].rpartition("/")[2], each)
        is_proven = PROVEN in page(walk, "GET", f"{SWAP}/look").text
        assert is_proven == (claimed["state"] == "equal"), f"{fault.__name__}: {claimed}"
        if is_proven:
            break
    assert claimed["state"] == "equal", claimed
    event = walk.plant.call("GET", f"/events?limit=1&kind=swap&unit={UNIT}&bus=dry-end").json()["events"][0]
    assert (event["what"], event["outcome"]) == ("unit replaced and verified", "verified")
    assert page(walk, "POST", f"{SWAP}/give-up").status_code == 303


def page(walk: Walk, method: str, path: str, **form: Any) -> httpx.Response:
    """One of the pages, as an engineer."""
    headers = {"Authorization": f"Bearer {walk.plant.tokens['engineer']}"}
    return walk.plant.client.request(method, path, headers=headers, **form)


@pytest.mark.parametrize(("seed", "restores", "replacements"), sizes((1, 3, 0), (2, 34, 8)))
def test_no_claim_of_a_restore_is_false(tmp_path: Path, seed: int, restores: int, replacements: int) -> None:
    random, unit = Random(seed), WatchedUnit(UNIT)
    walk = [restore_with] * restores + [replacement_with] * replacements
    random.shuffle(walk)
    faults = cycle(random.sample(FAULTS, len(FAULTS)))
    with ThreadPoolExecutor(2) as beside, dashboard(tmp_path, [Unit(1), unit]) as plant:
        walker = Walk(plant, unit, random, beside)
        for step, fault in zip(walk, faults, strict=False):
            step(walker, fault)


def claim(state: str, outcome: str | None, remaining: tuple[int, ...] = ()) -> dict[str, Any]:
    """What a restore of #6 reports."""
    rows = [{"number": 6, "selected": True, "outcome": outcome}]
    cause = "why" if state == "stopped" else None
    left = [{"number": number} for number in remaining]
    return {"state": state, "cause": cause, "rows": rows, "left_out": [], "remaining": left}


WRITTEN, SHOWN, OTHER = Seen("written", 6, 50), Seen("read", 6, 50), Seen("read", 6, 7)


@pytest.mark.parametrize(
    ("claimed", "seen", "found"),
    [
        (claim("equal", "verified"), [WRITTEN, SHOWN], ""),
        (claim("different", "verified", (6,)), [WRITTEN, SHOWN, OTHER], ""),
        (claim("stopped", "unverified"), [WRITTEN], ""),
        (claim("equal", "verified"), [SHOWN, WRITTEN, OTHER], "was not read as 50"),
        (claim("stopped", "verified"), [WRITTEN, OTHER], "never read as 50"),
        (claim("stopped", "verified"), [SHOWN], "no write of it arrived"),
        (claim("different", "verified"), [WRITTEN, SHOWN, OTHER, Seen("written", 6, 50)], "was not read so"),
        (claim("stopped", "refused"), [WRITTEN, Seen("refused", 6, 50)], "called refused"),
        (claim("stopped", "not_sent"), [WRITTEN], "called not_sent"),
        (claim("stopped", None), [Seen("acknowledged", 6, 50)], "called None"),
        (claim("stopped", "not_sent"), [Seen("written", 9, 1)], "no one requested"),
        (claim("running", None), [], "without a cause"),
    ],
)
def test_the_judge_finds_a_false_claim(claimed: dict[str, Any], seen: list[Seen], found: str) -> None:
    complained = complaints(claimed, {6: 50}, seen, [])
    assert (found in complained[0] and len(complained) == 1) if found else complained == []
