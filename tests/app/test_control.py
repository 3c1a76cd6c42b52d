"""Who holds control, over time."""

from __future__ import annotations

import pytest

from app.commands.safeguards.control import LAPSES_AFTER_S, Control, ControlledError
from bus.messages import Message


def test_control_lapses_without_use_and_use_keeps_it() -> None:
    control = Control(required=True)
    control.take("bus", "anna", 0.0)
    control.use("bus", "anna", LAPSES_AFTER_S - 1)
    assert control.holding("bus", LAPSES_AFTER_S + 1) is not None
    assert control.holding("bus", 2 * LAPSES_AFTER_S) is None
    control.take("bus", "ben", 2 * LAPSES_AFTER_S)


def test_taking_again_keeps_since() -> None:
    control = Control(required=True)
    control.take("bus", "anna", 5.0)
    assert control.take("bus", "anna", 9.0).since == 5.0


def test_each_bus_has_its_own_holder() -> None:
    control = Control(required=True)
    control.take("one", "anna", 0.0)
    control.take("two", "ben", 0.0)
    with pytest.raises(ControlledError, match="ben"):
        control.use("two", "anna", 0.0)


def test_whoever_is_gone_holds_nothing() -> None:
    control = Control(required=True)
    control.take("one", "anna", 0.0)
    control.take("two", "ben", 0.0)
    assert control.release_all_of("anna", 1.0) == ["one"]
    assert control.holding("one", 0.0) is None
    assert control.holding("two", 0.0) is not None


def test_what_had_lapsed_is_not_given_back() -> None:
    control = Control(required=True)
    control.take("one", "anna", 0.0)
    assert control.release_all_of("anna", LAPSES_AFTER_S) == []


def test_nobody_holds_it_says_so() -> None:
    with pytest.raises(ControlledError, match="nobody"):
        Control(required=True).use("bus", "anna", 0.0)
    with pytest.raises(ControlledError, match="nobody"):
        Control(required=True).release("bus", "anna", 0.0)


def test_a_review_is_told_who_else_holds_it_and_uses_nothing() -> None:
    control = Control(required=True)
    assert control.objection("one", "anna", 0.0) == Message("control_not_taken")
    control.take("one", "anna", 0.0)
    assert control.objection("one", "ben", 5.0) == Message.of("control_held", who="anna")
    assert control.objection("one", "anna", 5.0) is None
    holding = control.holding("one", 5.0)
    assert holding is not None
    assert holding.used_at == 0.0


def test_where_it_is_not_required_everybody_may() -> None:
    Control(required=False).use("bus", "anna", 0.0)
    assert Control(required=False).objection("bus", "anna", 0.0) is None
