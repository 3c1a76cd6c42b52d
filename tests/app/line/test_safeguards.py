"""Limits, blocks and control: over HTTP, and control of a bus over time against a model."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from app.core.database import Database, StoreConnection
from app.core.web.access import Person, Role
from app.errors import Problem
from app.line.commands import safeguards as service
from app.line.commands import service as command_service
from app.line.commands.control import LAPSES_AFTER_S, Control
from app.line.commands.limits import (
    NO_LIMITS,
    CommandBlock,
    Limits,
    Protection,
    ReadOnly,
    Restrictions,
    read_protection,
)
from app.people.audit.log import Filter
from bus.contract import Command, Update
from bus.instants import Monotonic, UnixTime, monotonic_now, unix_now
from bus.messages import Message
from tests.app.complete_app import House, commands_app
from tests.app.fake_worker import PlayedWorker, reading, responding, result_of, until
from tests.for_each import for_each


@pytest.fixture
async def controlled(tmp_path: Path) -> AsyncIterator[House]:
    async with commands_app(tmp_path, control=True) as built:
        yield built


async def obeying(site: House) -> PlayedWorker:
    """A worker whose units take every speed."""
    played = await site.worker()

    async def play(command: Command) -> Sequence[Update]:
        raw = getattr(command.action, "raw", 1000)
        return [reading(1, raw), result_of(command, "verified", read_back=raw)]

    played.play = play
    return played


async def speed(site: House, raw: int, **more: object) -> tuple[int, str]:
    """Status and code of setting unit 1."""
    name = str(more.pop("name", ""))
    response = await site.request("POST", "/units/1/speed", {"raw": raw, **more}, role="operator", name=name)
    return response.status_code, response.json()["code"]


async def test_limits_are_enforced_from_the_moment_they_are_set(site: House) -> None:
    worker = await obeying(site)
    nothing = dict.fromkeys(("lowest", "highest", "largest_step", "per_minute"))
    assert (await site.request("GET", "/units/1/limits")).json() == nothing
    put = await site.request("PUT", "/units/1/limits", {"lowest": 900, "highest": 1200}, role="engineer")
    assert put.status_code == 200
    assert (await site.request("GET", "/units/1/limits", role="viewer")).json()["highest"] == 1200
    assert await speed(site, 1201) == (422, "invalid")
    assert await speed(site, 899) == (422, "invalid")
    line = await site.request("POST", "/speeds", {"setpoints": {"1": {"raw": 1201}, "2": {"raw": 1}}})
    assert line.status_code == 422
    assert worker.commands == []
    assert await speed(site, 1200) == (200, "verified")
    assert await speed(site, 0) == (200, "verified")


async def test_a_large_step_needs_confirmation(site: House) -> None:
    await obeying(site)
    await site.request("PUT", "/units/1/limits", {"largest_step": 50})
    assert await speed(site, 1051) == (409, "confirm_needed")
    assert await speed(site, 1051, confirm=True) == (200, "verified")
    assert await speed(site, 1101) == (200, "verified")


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
async def test_a_clock_that_is_set_neither_forgives_movement_nor_ends_control(
    site: House, monkeypatch: pytest.MonkeyPatch, step_s: float
) -> None:
    await obeying(site)
    site.guards.control.required = True
    anna, ben = (Person(name, Role.OPERATOR, "session") for name in ("anna", "ben"))
    await site.guards.take(anna)
    since = site.guards.holding().since
    await site.request("PUT", "/units/1/limits", {"per_minute": 100})
    assert await speed(site, 1100, name="anna") == (200, "verified")
    for module in (command_service, service):
        monkeypatch.setattr(module, "unix_now", lambda: time.time() + step_s)
    assert await speed(site, 1101, name="anna") == (422, "invalid")
    assert (site.guards.holder(), site.guards.holding().since) == ("anna", since)
    with pytest.raises(Problem, match="anna"):
        await site.guards.take(ben)
    left = site.guards.bus_control().lapses_at - (time.time() + step_s)
    assert LAPSES_AFTER_S - 60 < left <= LAPSES_AFTER_S


async def test_movement_counts_for_a_minute_that_has_passed(
    site: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    await obeying(site)
    await site.request("PUT", "/units/1/limits", {"per_minute": 100})
    assert await speed(site, 1100) == (200, "verified")
    real = time.monotonic
    monkeypatch.setattr(site.commands, "_monotonic", lambda: real() + 59.0)
    assert await speed(site, 1101) == (422, "invalid")
    monkeypatch.setattr(site.commands, "_monotonic", lambda: real() + 61.0)
    assert await speed(site, 1101) == (200, "verified")


async def test_two_moves_at_once_do_not_both_pass(site: House) -> None:
    await obeying(site)
    await site.request("PUT", "/units/1/limits", {"per_minute": 100})
    outcomes = await asyncio.gather(speed(site, 1060), speed(site, 1080))
    assert sorted(outcomes) == [(200, "verified"), (422, "invalid")]


async def test_what_did_not_move_does_not_count(site: House) -> None:
    worker = await site.worker()
    worker.play = responding("refused", unit_error=128)
    await site.request("PUT", "/units/1/limits", {"per_minute": 100})
    assert await speed(site, 1100) == (409, "refused")
    assert await speed(site, 1100) == (409, "refused")


async def test_limits_keep_the_decimals_they_were_typed_for(site: House) -> None:
    limits = Limits(highest=1500, decimals=1)
    await site.guards.restrictions.put_limits(1, limits, "anna", unix_now())
    again = Restrictions(site.services[Database], "dry-end")
    await again.load(unix_now(), monotonic_now())
    assert again.limits(1) == limits
    await site.request("PUT", "/units/1/limits", {"highest": 1500})
    await again.load(unix_now(), monotonic_now())
    assert again.limits(1) == Limits(highest=1500), "given raw, they hold for every display"


async def test_what_guards_a_store_of_an_earlier_version_is_read(site: House) -> None:
    await site.guards.restrictions.put_limits(1, Limits(highest=1500), "anna", unix_now())

    def former(store: StoreConnection) -> Protection:
        store.execute("DROP TABLE limits_scale")
        return read_protection(store)

    protection = await site.services[Database].write(former)
    assert protection.keys() == {"blocks", "limits"}
    assert len(protection["limits"]) == 1


@for_each(
    "body",
    [{"lowest": 5, "highest": 4}, {"lowest": -1}, {"highest": 100000}, {"fastest": 1}, {"lowest": True}],
)
async def test_limits_that_make_no_sense_are_refused(site: House, body: dict[str, object]) -> None:
    assert (await site.request("PUT", "/units/1/limits", body)).status_code == 422
    assert site.guards.limits(1) == NO_LIMITS


async def test_a_block_is_refused_shown_recorded_and_lifted(site: House) -> None:
    worker = await obeying(site)
    notified: list[int] = []
    site.guards.on_block(notified.append)
    body = {"reason": " belt off since 14:20, do not run "}
    blocked = await site.request("POST", "/units/1/block", body, role="operator", name="anna")
    assert blocked.json()["by"] == "anna"
    refused = await site.request("POST", "/units/1/speed", {"raw": 5})
    assert refused.status_code == 423
    assert refused.json()["code"] == "blocked"
    assert "belt off since 14:20" in refused.json()["detail"]
    assert (await site.request("GET", "/units/1/block", role="viewer")).json()["blocked"] is True
    assert "belt off" in (await site.request("GET", "/units/1")).json()["blocked"]["detail"]
    assert worker.commands == []
    assert (await site.request("DELETE", "/units/1/block", role="operator")).json()["blocked"] is False
    assert await speed(site, 5) == (200, "verified")
    assert notified == [1, 1]
    events = (await site.http().get("/api/v1/events?kind=block")).json()["events"]
    assert [event["what"] for event in events] == ["command block lifted", "commands blocked"]


async def test_a_block_needs_a_reason(site: House) -> None:
    for body in ({}, {"reason": ""}, {"reason": "  "}, {"reason": "x" * 201}):
        assert (await site.request("POST", "/units/1/block", body)).status_code == 422


async def test_lifting_nothing_is_no_event(site: House) -> None:
    assert (await site.request("DELETE", "/units/1/block")).status_code == 200
    assert (await site.http().get("/api/v1/events?kind=block")).json()["events"] == []


async def test_a_read_only_bus_takes_no_command(site: House) -> None:
    worker = await obeying(site)
    notified: list[int] = []
    site.guards.on_block(notified.append)
    body = {"on": True, "reason": "cable is open", "minutes": 30}
    for role in ("viewer", "operator", "engineer"):
        assert (await site.request("POST", "/read-only", body, role=role)).status_code == 403
    shown = (await site.request("POST", "/read-only", body, role="admin")).json()
    assert (shown["on"], shown["reason"], shown["until"] > shown["since"]) == (True, "cable is open", True)
    assert sorted(notified) == sorted(site.live.units)
    assert await speed(site, 1500) == (423, "blocked")
    execute = await site.request("POST", "/execute", {}, role="admin")
    assert (execute.status_code, execute.json()["code"]) == (423, "blocked")
    assert "cable is open" in execute.json()["detail"]
    assert worker.commands == []
    assert (await site.request("POST", "/read-only", {"on": False})).json()["on"] is False
    assert (await site.request("POST", "/read-only", {"on": False})).json()["on"] is False
    assert await speed(site, 5) == (200, "verified")
    events = (await site.http().get("/api/v1/events?kind=block")).json()["events"]
    assert [(event["what"], event["old"], event["new"]) for event in events] == [
        ("read-only mode ended", "cable is open", None),
        ("bus set to read-only", None, "cable is open (for 30 min)"),
    ]


async def test_a_read_only_bus_takes_what_makes_it_slower_and_nothing_else(site: House) -> None:
    worker = await obeying(site)
    assert await speed(site, 500) == (200, "verified")
    await site.request("POST", "/read-only", {"on": True, "reason": "cable is open"})
    assert site.guards.block_reason(1) is not None
    assert site.guards.block_reason(1, slows=True) is None, "what setting the line to zero goes by"
    assert await speed(site, 501) == (423, "blocked")
    assert await speed(site, 400, execute=False) == (423, "blocked")
    assert await speed(site, 400) == (200, "verified")
    assert await speed(site, 0) == (200, "verified")
    assert await speed(site, 400) == (423, "blocked")
    sent = [getattr(command.action, "raw", None) for command in worker.commands]
    assert sent == [500, 400, 0]
    await site.request("POST", "/units/1/block", {"reason": "belt off"}, role="operator")
    assert await speed(site, 0) == (423, "blocked"), "a block of the unit is the operator's"


async def test_a_speed_that_is_under_way_when_the_bus_becomes_read_only_goes_on_where_it_slows(
    site: House,
) -> None:
    worker = await obeying(site)
    assert await speed(site, 500) == (200, "verified")
    held = asyncio.Event()

    async def play(command: Command) -> Sequence[Update]:
        await held.wait()
        raw = getattr(command.action, "raw", 0)
        return [reading(1, raw), result_of(command, "verified", read_back=raw)]

    worker.play = play
    slower = asyncio.create_task(speed(site, 100))
    await until(lambda: len(worker.commands) == 2, "the slower speed is sent")
    await site.request("POST", "/read-only", {"on": True, "reason": "cable is open"})
    held.set()
    assert await slower == (200, "verified")


@for_each(
    "body",
    [
        {},
        {"on": True},
        {"on": True, "reason": "x" * 201},
        {"on": True, "reason": "x", "minutes": 0},
        {"on": True, "reason": "x", "minutes": 10081},
    ],
)
async def test_a_bad_request_of_read_only_changes_nothing(site: House, body: dict[str, Any]) -> None:
    assert (await site.request("POST", "/read-only", body)).status_code == 422
    assert (await site.request("GET", "/read-only", role="viewer")).json()["on"] is False


async def test_read_only_ends_after_its_minutes_whatever_the_wall_clock_does(
    site: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    await obeying(site)
    await site.request("POST", "/read-only", {"on": True, "reason": "x", "minutes": 1})
    notified: list[int] = []
    site.guards.on_block(notified.append)
    real = time.monotonic
    monkeypatch.setattr(service, "unix_now", lambda: UnixTime(time.time() + 3600))
    assert await speed(site, 1500) == (423, "blocked")
    monkeypatch.setattr(service, "monotonic_now", lambda: Monotonic(real() + 61))
    assert await speed(site, 5) == (200, "verified")


async def test_read_only_survives_a_restart_and_not_its_end(tmp_path: Path) -> None:
    database = Database(tmp_path / "lineside.db")
    now, monotonic = UnixTime(1000.0), Monotonic(10.0)
    mode = ReadOnly("why", "anna", now, UnixTime(1060.0))
    await Restrictions(database, "b").put_read_only(mode, monotonic)
    stored, other = Restrictions(database, "b"), Restrictions(database, "c")
    await stored.load(UnixTime(1020.0), Monotonic(0.0))
    await other.load(now, monotonic)
    assert stored.read_only(Monotonic(39.0)) == mode
    assert stored.read_only(Monotonic(40.0)) is None
    assert other.read_only(monotonic) is None
    await stored.put_read_only(ReadOnly("why", "anna", now), monotonic)
    assert stored.read_only_left_s(monotonic) == math.inf
    await stored.end_read_only()
    await stored.load(now, monotonic)
    assert stored.read_only(monotonic) is None
    database.close()


async def test_limits_and_blocks_survive_a_restart(tmp_path: Path) -> None:
    database = Database(tmp_path / "lineside.db")
    limits, block = (
        Limits(lowest=1, highest=2, largest_step=3, per_minute=4),
        CommandBlock("why", "anna", 5.0),
    )
    written = Restrictions(database, "b")
    await written.put_limits(1, limits, "anna", 1.0)
    await written.put_block(1, block)
    stored = Restrictions(database, "b")
    await stored.load(unix_now(), monotonic_now())
    assert (stored.limits(1), stored.block(1)) == (limits, block)
    await stored.lift_block(1)
    await stored.load(unix_now(), monotonic_now())
    assert stored.block(1) is None
    database.close()


async def test_one_user_has_control_and_all_see_who(controlled: House) -> None:
    worker = await obeying(controlled)
    assert await speed(controlled, 5, name="anna") == (409, "controlled")
    taken = await controlled.request("POST", "/control", role="operator", name="anna")
    assert taken.json()["holder"] == "anna"
    assert await speed(controlled, 5, name="anna") == (200, "verified")
    assert await speed(controlled, 6, name="ben") == (409, "controlled")
    assert (await controlled.request("POST", "/control", role="operator", name="ben")).status_code == 409
    assert (await controlled.request("GET", "/control", role="viewer")).json()["holder"] == "anna"
    assert len(worker.commands) == 1


async def test_control_is_handed_over_released_and_taken_by_an_admin(controlled: House) -> None:
    await obeying(controlled)
    await controlled.request("POST", "/control", role="operator", name="anna")
    by_ben = await controlled.request(
        "POST", "/control/hand-over", {"to": "ben"}, role="operator", name="ben"
    )
    assert by_ben.status_code == 409
    await controlled.request("POST", "/control/hand-over", {"to": "ben"}, role="operator", name="anna")
    assert await speed(controlled, 5, name="ben") == (200, "verified")
    controlled.http("viewer", "vera")
    for other, word in (("nobody", "there is no user nobody"), ("vera", "vera has the role viewer")):
        refused = await controlled.request(
            "POST", "/control/hand-over", {"to": other}, role="operator", name="ben"
        )
        assert (refused.status_code, refused.json()["code"]) == (422, "invalid")
        assert word in refused.json()["detail"]
    assert await speed(controlled, 5, name="ben") == (200, "verified")
    forced = await controlled.request("POST", "/control/hand-over", {"to": "chef"}, role="admin", name="chef")
    assert forced.json()["holder"] == "chef"
    assert (await controlled.request("DELETE", "/control", role="operator", name="ben")).status_code == 409
    assert (await controlled.request("DELETE", "/control", role="admin", name="chef")).json()[
        "holder"
    ] is None
    events = (await controlled.http().get("/api/v1/events?kind=control")).json()["events"]
    assert [event["what"] for event in events] == [
        *("control released", "control handed over", "control handed over", "control taken")
    ]


async def step(site: House, method: str, path: str, name: str) -> tuple[int, dict[str, Any]]:
    response = await site.request(method, f"/control{path}", role="operator", name=name)
    return response.status_code, response.json()


async def test_control_is_requested_declined_requested_again_and_granted(controlled: House) -> None:
    await obeying(controlled)
    changes: list[str] = []
    controlled.guards.on_control(lambda: changes.append(controlled.guards.bus_control().key))
    assert (await step(controlled, "POST", "/request", "ben"))[0] == 409
    await step(controlled, "POST", "/take", "anna")
    status, shown = await step(controlled, "POST", "/request", "ben")
    assert (status, shown["holder"], shown["request_lapses_after_s"]) == (200, "anna", 60.0)
    assert (shown["request"]["by"], shown["request"]["state"]) == ("ben", "pending")
    assert await speed(controlled, 5, name="ben") == (409, "controlled")
    assert (await step(controlled, "POST", "/grant", "ben"))[0] == 409
    status, shown = await step(controlled, "DELETE", "/request", "anna")
    assert (status, shown["request"]["state"]) == (200, "declined")
    status, problem = await step(controlled, "POST", "/request", "ben")
    assert (status, problem["code"]) == (409, "controlled")
    await step(controlled, "POST", "/release", "anna")
    await step(controlled, "POST", "/take", "anna")
    await step(controlled, "POST", "/request", "ben")
    status, shown = await step(controlled, "POST", "/grant", "anna")
    assert (status, shown["holder"], shown["request"]) == (200, "ben", None)
    assert await speed(controlled, 5, name="ben") == (200, "verified")
    assert len(changes) == len(set(changes)) == 7
    events = (await controlled.http().get("/api/v1/events?kind=control")).json()["events"]
    assert [(event["what"], event["who"], event["new"]) for event in events] == [
        ("control handed over", "anna", "ben"),
        ("control requested", "ben", "ben"),
        ("control taken", "anna", "anna"),
        ("control released", "anna", None),
        ("request for control ended", "anna", "declined"),
        ("control requested", "ben", "ben"),
        ("control taken", "anna", "anna"),
    ]


async def test_reading_needs_no_control(controlled: House) -> None:
    worker = await obeying(controlled)
    await controlled.request("GET", "/units/1/parameters?refresh=true", role="viewer")
    assert len(worker.commands) == 1


async def test_control_is_released_when_its_holder_is_gone_with_an_event(controlled: House) -> None:
    assert (await controlled.request("POST", "/control", role="operator")).status_code == 200
    await controlled.guards.revoke_control("operator")
    assert controlled.guards.holder() == ""
    newest = (await controlled.log.page(Filter(kind="control"), 1))[0][0]
    assert (newest["what"], newest["old"], newest["who"]) == ("control released", "operator", "operator")
    await controlled.guards.revoke_control("operator")
    assert len((await controlled.log.page(Filter(kind="control"), 9))[0]) == 2


AT = UnixTime(1_700_000_000.0)
"""What the wall clock shows; nothing lapses by it."""


def test_control_lapses_without_use_and_use_keeps_it() -> None:
    control = Control(required=True)
    control.take("anna", 0.0, AT)
    control.use("anna", LAPSES_AFTER_S - 1)
    assert control.holding(LAPSES_AFTER_S + 1) is not None
    assert control.holding(2 * LAPSES_AFTER_S) is None
    control.take("ben", 2 * LAPSES_AFTER_S, AT)


def test_taking_again_keeps_since() -> None:
    control = Control(required=True)
    control.take("anna", 5.0, AT)
    assert control.take("anna", 9.0, AT + 4.0).since == AT


def test_what_had_lapsed_is_not_given_back() -> None:
    control = Control(required=True)
    control.take("anna", 0.0, AT)
    assert not control.revoke("anna", LAPSES_AFTER_S)


def test_a_review_names_the_holder_and_takes_nothing() -> None:
    control = Control(required=True)
    assert control.objection("anna", 0.0) == Message("control_not_taken")
    control.take("anna", 0.0, AT)
    assert control.objection("ben", 5.0) == Message.of("control_held", who="anna")
    assert control.objection("anna", 5.0) is None
    holding = control.holding(5.0)
    assert holding is not None
    assert holding.used_at == 0.0


def test_without_the_requirement_all_operators_may() -> None:
    assert Control(required=False).use("anna", 0.0) is None
    assert Control(required=False).objection("anna", 0.0) is None


PEOPLE = st.sampled_from(["anna", "ben", "chef"])
HOLDS_S, PENDING_S, RESTS_S = 600.0, 60.0, 60.0


class ControlModel(RuleBasedStateMachine):
    """``self.log`` holds (time, what, who) of everything that had an effect."""

    def __init__(self) -> None:
        super().__init__()
        self.control = Control(required=True)
        self.now = 0.0
        self.log: list[tuple[float, str, str]] = []

    # --- what the log means -----------------------------------------------------------------------

    def holder(self) -> str:
        holder, used = "", 0.0
        for at, what, who in self.log:
            if holder and at - used >= HOLDS_S:
                holder = ""
            if what == "holds":
                holder, used = who, at
            elif what == "uses":
                used = at
            elif what == "frees":
                holder = ""
        return "" if holder and self.now - used >= HOLDS_S else holder

    def requested(self) -> tuple[str, str]:
        """Who requests control from the present holder, and the state of that."""
        by, since, declined = "", 0.0, None
        for at, what, who in self.log:
            if what == "requests":
                by, since, declined = who, at, None
            elif what in ("holds", "frees", "withdraws"):
                by = ""
            elif what == "declines":
                declined = at
        if not by or not self.holder():
            return "", ""
        if declined is not None:
            return (by, "declined") if self.now - declined < RESTS_S else ("", "")
        if self.now - since < PENDING_S:
            return by, "pending"
        return (by, "lapsed") if self.now - since < PENDING_S + RESTS_S else ("", "")

    def rests(self, who: str) -> bool:
        """Whether the present holder declined a request of this account less than a minute ago."""
        by, rests = "", False
        for at, what, account in self.log:
            if what == "requests":
                by = account
            elif what in ("holds", "frees"):
                rests = False
            elif what == "declines" and by == who:
                rests = self.now - at < RESTS_S
        return rests

    @contextmanager
    def allowed(self, allowed: bool) -> Iterator[None]:
        with nullcontext() if allowed else pytest.raises(Problem, match="control"):
            yield

    def note(self, what: str, who: str, *, if_: bool = True) -> None:
        if if_:
            self.log.append((self.now, what, who))

    # --- what people do ---------------------------------------------------------------------------

    @rule(seconds=st.sampled_from([0.0, 1.0, 20.0, 59.0, 60.0, 61.0, 300.0, 599.0, 600.0]))
    def time_passes(self, seconds: float) -> None:
        self.now += seconds

    @rule(who=PEOPLE)
    def take(self, who: str) -> None:
        holder = self.holder()
        with self.allowed(holder in ("", who)):
            self.control.take(who, self.now, UnixTime(self.now))
        self.note("holds", who, if_=not holder)
        self.note("uses", who, if_=holder == who)

    @rule(who=PEOPLE)
    def write(self, who: str) -> None:
        may = self.holder() == who
        assert (self.control.use(who, self.now) is None) == may
        self.note("uses", who, if_=may)

    @rule(who=PEOPLE)
    def release(self, who: str) -> None:
        may = self.holder() == who
        with self.allowed(may):
            self.control.release(who, self.now)
        self.note("frees", who, if_=may)

    @rule(who=PEOPLE)
    def request(self, who: str) -> None:
        holder, (by, state) = self.holder(), self.requested()
        repeated = (by, state) == (who, "pending")
        refused = (
            holder in ("", who)
            or (state == "pending" and not repeated)
            or (state != "pending" and self.rests(who))
        )
        with self.allowed(not refused):
            assert self.control.request(who, self.now) is not repeated
        self.note("requests", who, if_=not refused and not repeated)

    @rule(who=PEOPLE)
    def grant(self, who: str) -> None:
        by, state = self.requested()
        may = self.holder() == who and state == "pending"
        with self.allowed(may):
            to = self.control.requester(who, self.now)
            assert to == by
            self.control.hand_over(who, to, self.now, UnixTime(self.now))
        self.note("holds", by, if_=may)

    @rule(who=PEOPLE)
    def end_request(self, who: str) -> None:
        by, state = self.requested()
        may = state == "pending" and who in (by, self.holder())
        with self.allowed(may):
            self.control.end_request(who, self.now)
        self.note("withdraws" if who == by else "declines", who, if_=may)

    @rule(who=PEOPLE)
    def leave(self, who: str) -> None:
        """The account is signed in nowhere any more."""
        held, (by, _) = self.holder() == who, self.requested()
        assert self.control.revoke(who, self.now) == held
        self.note("frees", who, if_=held)
        self.note("withdraws", who, if_=not held and by == who)

    @invariant()
    def the_same_is_shown(self) -> None:
        holding, request = self.control.holding(self.now), self.control.request_now(self.now)
        assert (holding.holder if holding else "") == self.holder()
        assert ((request.by, request.state(self.now)) if request else ("", "")) == self.requested()

    @invariant()
    def a_request_takes_control_from_no_holder(self) -> None:
        by, _ = self.requested()
        assert not by or by != self.holder()


TestControl = ControlModel.TestCase
