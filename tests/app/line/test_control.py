"""Control of a bus over time, also judged by a model: a log of events, read anew for each statement."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from app.errors import Problem
from app.line.commands.control import LAPSES_AFTER_S, REQUEST_RESTS_S, Control
from bus.instants import UnixTime
from bus.messages import Message

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


def test_only_the_holder_uses_it() -> None:
    control = Control(required=True)
    control.take("ben", 0.0, AT)
    assert control.use("anna", 0.0) == Message.of("control_held", who="ben")
    assert control.use("ben", 0.0) is None


def test_control_is_revoked_from_its_holder_only() -> None:
    control = Control(required=True)
    control.take("anna", 0.0, AT)
    assert not control.revoke("ben", 1.0)
    assert control.holding(1.0) is not None
    assert control.revoke("anna", 1.0)
    assert control.holding(0.0) is None


def test_what_had_lapsed_is_not_given_back() -> None:
    control = Control(required=True)
    control.take("anna", 0.0, AT)
    assert not control.revoke("anna", LAPSES_AFTER_S)


def test_free_control_is_reported() -> None:
    assert Control(required=True).use("anna", 0.0) == Message("control_not_taken")
    with pytest.raises(Problem, match="free"):
        Control(required=True).release("anna", 0.0)


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


def test_a_request_of_another_account_does_not_end_the_rest_of_a_declined_one() -> None:
    control = Control(required=True)
    control.take("anna", 0.0, AT)
    control.request("ben", 1.0)
    control.end_request("anna", 2.0)
    control.request("chef", 3.0)
    control.end_request("chef", 4.0)
    with pytest.raises(Problem, match="requested again in"):
        control.request("ben", 5.0)
    assert control.request("ben", 2.0 + REQUEST_RESTS_S)


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
