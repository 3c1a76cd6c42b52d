"""The rules of a lease, judged by a second model over random histories: never two homes at one moment."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from types import ModuleType

import pytest

from app.home import homes, lease
from app.home.keeping import keeper
from app.home.lease import (
    LEASE_S,
    MARGIN_S,
    UNSEEN,
    Claimant,
    HomeRow,
    Lease,
    Sighting,
    Verdict,
    next_free,
    verdict,
)
from bus.contract import MAX_EPOCH
from bus.instants import Monotonic, UnixTime

HISTORIES, STEPS = 400, 250


def row(**changes: object) -> HomeRow:
    """Held by a, until 105 of the store's clock."""
    held: dict[str, object] = {
        "bus": "dry-end",
        "holder": "a",
        "instance": "a1",
        "epoch": 3,
        "until": 105.0,
        "renewals": 7,
        "url": "http://a",
        "taken_at": 50.0,
        "reason": "",
        "released": "",
        "requested_by": "",
        "requested_for": "",
        "request_ends": 0.0,
    }
    return HomeRow(**{**held, **changes})  # type: ignore[arg-type]


A, B = Claimant("a", "a2"), Claimant("b", "b1")
B_MANUAL = Claimant("b", "b1", automatic=False)
SEEN_LONG = 100.0
"""Since when the row is seen unchanged, where the present is 105 and it has lapsed."""


@pytest.mark.parametrize(
    ("stored", "claimant", "unchanged_s", "store_now", "expected"),
    [
        (row(), B, 5.0, 105.0, "may_take"),
        (row(), B, 4.9, 105.0, "held"),
        (row(), B, 60.0, 104.9, "held"),
        (row(), A, 1.0, 101.0, "held_by_namesake"),
        (row(), Claimant("a", "a1"), 1.0, 101.0, "held"),
        (row(), A, 5.0, 106.0, "may_take"),
        (row(), B_MANUAL, 60.0, 200.0, "local"),
        (row(), A._replace(automatic=False), 60.0, 200.0, "may_take"),
        (row(), B._replace(permitted=False), 60.0, 200.0, "not_permitted"),
        (row(released="a1"), B, 0.0, 101.0, "may_take"),
        (row(released="a1"), B_MANUAL, 60.0, 200.0, "local"),
        (row(requested_for="b", request_ends=130.0), B_MANUAL, 5.0, 106.0, "may_take"),
        (row(requested_for="b", request_ends=130.0), B_MANUAL, 1.0, 101.0, "held"),
        (row(requested_for="c", request_ends=130.0), B, 60.0, 106.0, "promised"),
        (row(requested_for="c", request_ends=105.0), B, 60.0, 106.0, "may_take"),
        (None, B, 5.0, 0.0, "may_take"),
        (None, B, 1.0, 0.0, "held"),  # it was deleted by hand: its epoch remains
        # Edited by hand: an until of a year, and one of an hour ago while the holder lives.
        (row(until=9e9), B, 5.0, 105.0, "may_take"),
        (row(until=9e9), B, 4.0, 105.0, "held"),
        (row(until=1.0), B, 1.0, 105.0, "held"),
        (row(instance="", released=""), B, 1.0, 101.0, "held"),
        (row(epoch=-1), B, 60.0, 200.0, "unusable"),
        (row(epoch=MAX_EPOCH), B, 60.0, 200.0, "unusable"),
    ],
)
def test_who_may_take_a_bus(
    stored: HomeRow | None, claimant: Claimant, unchanged_s: float, store_now: float, expected: Verdict
) -> None:
    sighting = Sighting(stored, Monotonic(1000.0 - unchanged_s), 1, highest=3)
    assert verdict(sighting, claimant, Monotonic(1000.0), UnixTime(store_now)) == expected


def test_a_bus_that_no_server_ever_had_is_free_at_once() -> None:
    assert verdict(UNSEEN, B, Monotonic(1.0), UnixTime(0.0)) == "held", "not before it was looked for"
    assert verdict(UNSEEN.again(None, Monotonic(0.0)), B, Monotonic(0.0), UnixTime(0.0)) == "may_take"


def test_a_renewal_that_takes_long_counts_from_when_it_was_begun() -> None:
    lease = Lease(1, Monotonic(10.0)).renewed(Monotonic(12.0))
    assert lease.left_s(Monotonic(15.0)) == LEASE_S - MARGIN_S - 3.0
    assert lease.renewed(Monotonic(11.0)) == lease, "an older one that is confirmed later extends nothing"


def test_a_request_and_a_reason_are_no_sign_of_life() -> None:
    seen = Sighting(row(), Monotonic(1.0), 1)
    assert seen.again(row(reason="x", requested_for="b", url="http://c"), Monotonic(9.0)).since == Monotonic(
        1.0
    )
    for change in (
        {"until": 106.0},
        {"renewals": 8},
        {"epoch": 4},
        {"holder": "b"},
        {"instance": "x"},
        {"released": "a1"},
    ):
        assert seen.again(row(**change), Monotonic(9.0)).since == Monotonic(9.0)
    assert seen.again(None, Monotonic(9.0)).since == Monotonic(9.0)


def test_the_next_look_is_when_a_bus_may_become_free() -> None:
    seen = [Sighting(row(), Monotonic(since), 1) for since in (1.0, 3.0, 4.0)]
    assert next_free([*seen, UNSEEN], Monotonic(6.0)) == Monotonic(8.0), (
        "what was free before then is not looked at for it"
    )
    assert next_free([], Monotonic(6.0)) == Monotonic(math.inf)


# --- the second model ---------------------------------------------------------------------------------


@dataclass
class Process:
    """A server that may stand still between any two of its steps. Its clock begins anywhere."""

    claimant: Claimant
    offset: float
    sighting: Sighting = UNSEEN
    lease: Lease | None = None
    frozen_until: float = 0.0
    began: Monotonic | None = None
    """When it began a renewal that the store has not carried out yet."""
    stored: Monotonic | None = None
    """The same, once the store has; the process has not learned of it."""
    read: tuple[HomeRow | None, int] = (None, 0)
    is_reading: bool = False
    spans: list[tuple[float, float]] = field(default_factory=list)

    def clock(self, true: float) -> Monotonic:
        return Monotonic(true + self.offset)

    def believes(self, true: float) -> bool:
        """Whether it would write to the port now."""
        return self.lease is not None and self.lease.left_s(self.clock(true)) > 0


@dataclass
class World:
    """Two servers and one row. The judge looks at true time alone, which no server knows."""

    chance: random.Random
    true: float = 1000.0
    store_offset: float = 0.0
    row: HomeRow | None = None
    epochs: list[int] = field(default_factory=list)
    taken: int = 0

    def __post_init__(self) -> None:
        names = (("a", "a1"), ("b", "b1"), ("a", "namesake"))
        self.processes = [
            Process(Claimant(name, instance), self.chance.uniform(0, 1e6)) for name, instance in names
        ]

    @property
    def store_now(self) -> UnixTime:
        return UnixTime(self.true + self.store_offset)

    def step(self) -> None:
        self.true += self.chance.choice((0.0, 0.01, 0.1, 0.4, 1.0))
        if self.chance.random() < 0.02:
            self.store_offset += self.chance.choice((-3600.0, -5.0, 5.0, 3600.0))
        if self.chance.random() < 0.02:
            self.edit()
        process = self.chance.choice(self.processes)
        if self.chance.random() < 0.03:
            process.frozen_until = self.true + self.chance.uniform(0.0, 20.0)
        if process.frozen_until <= self.true:
            self.act(process)
        # The store works on while a process stands still.
        for each in self.processes:
            if each.began is not None and self.chance.random() < 0.7:
                self.carry_out(each)
        self.judge()

    def act(self, process: Process) -> None:
        now = process.clock(self.true)
        if process.stored is not None:
            self.learn(process, now)
        elif process.began is None:
            process.began = now
        if process.lease is not None and process.lease.left_s(now) <= 0:
            self.release(process, process.lease)
            process.lease = None

    def release(self, process: Process, lease: Lease) -> None:
        """What has lapsed is free at once, also where it was renewed meanwhile."""
        if self.row is not None and self.is_of(self.row, process, lease):
            self.row = self.row._replace(released=process.claimant.instance)

    def carry_out(self, process: Process) -> None:
        lease, stored = process.lease, self.row
        if lease is not None and stored is not None and self.is_of(stored, process, lease):
            until, renewals = self.store_now + LEASE_S, stored.renewals + 1
            self.row = stored._replace(until=until, renewals=renewals)
        process.read = self.row, max(self.epochs, default=0)
        process.stored, process.began = process.began, None

    def learn(self, process: Process, now: Monotonic) -> None:
        """The response of the store, as it was then; what is taken is decided by the row as it is now."""
        began, process.stored = process.stored, None
        assert began is not None
        read, highest = process.read
        process.sighting = process.sighting.again(read, now, highest)
        if process.lease is not None:
            if read is None or not self.is_of(read, process, process.lease):
                process.lease = None
            else:
                process.lease = process.lease.renewed(began)
            return
        begun = process.clock(self.true)
        seen = process.sighting.again(self.row, begun, max(self.epochs, default=0))
        if verdict(seen, process.claimant, begun, self.store_now) != "may_take":
            return
        epoch = max([self.row.epoch if self.row else 0, *self.epochs]) + 1
        self.row = row(
            holder=process.claimant.server,
            instance=process.claimant.instance,
            epoch=epoch,
            until=self.store_now + LEASE_S,
            renewals=0 if self.row is None else self.row.renewals + 1,
        )
        self.epochs.append(epoch)
        self.taken += 1
        process.lease = Lease(epoch, begun)

    def is_of(self, stored: HomeRow, process: Process, lease: Lease) -> bool:
        mine = (process.claimant.server, process.claimant.instance, lease.epoch)
        return (stored.holder, stored.instance, stored.epoch) == mine

    def edit(self) -> None:
        """By hand, in any way but the one that only a server writes."""
        if self.row is None:
            return
        change = self.chance.choice(("until", "gone", "holder", "epoch", "instance"))
        values = {"until": UnixTime(self.chance.choice((0.0, 9e9))), "holder": "b", "epoch": 1}
        values["instance"] = self.chance.choice(("", "b1", "x"))
        self.row = None if change == "gone" else self.row._replace(**{change: values[change]})  # type: ignore[arg-type]

    def judge(self) -> None:
        """At most one process may write."""
        writers = [each.claimant.instance for each in self.processes if each.believes(self.true)]
        assert len(writers) <= 1, f"two homes at {self.true}: {writers}"


def test_no_history_has_two_homes_at_one_moment() -> None:
    taken = 0
    for seed in range(HISTORIES):
        world = World(random.Random(seed))
        for _ in range(STEPS):
            world.step()
        taken += world.taken
    assert taken > 3 * HISTORIES, "homes are taken, lost and taken again"


@pytest.mark.parametrize("module", [lease, homes, keeper])
def test_clocks_of_servers_that_differ_by_an_hour_have_no_effect(module: ModuleType) -> None:
    """None is read: the store's clock comes with each look, and all else is monotonic."""
    names = set(vars(module))
    assert names.isdisjoint({"unix_now", "time", "datetime"})
