"""Who holds control, over time."""

from __future__ import annotations

import pytest

from app.errors import Problem
from app.line.commands.safeguards.control import LAPSES_AFTER_S, REQUEST_RESTS_S, Control
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
