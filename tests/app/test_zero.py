from __future__ import annotations

from app.commands.zero import plan_zero
from bus.contract import BusLink, ParameterValue
from tests.app.screens import AT_SPEED, line, reading


def nobody(_unit: int) -> bool:
    return False


def test_every_unit_that_can_be_told_is() -> None:
    plan = plan_zero(line().buses["dry"], nobody, 100.0)
    assert plan.units == {1: "Unit 1", 2: "Unit 2"}
    assert plan.left_out == {}
    assert plan.seconds == 12.0


def test_followers_come_down_with_their_master() -> None:
    live = line()
    live.apply("dry", [ParameterValue(unit=2, number=8, at=1, raw=1)])
    plan = plan_zero(live.buses["dry"], nobody, 100.0)
    assert (list(plan.units), plan.followers, plan.left_out) == ([1], 1, {})


def test_each_that_cannot_be_told_has_its_reason() -> None:
    live = line(4)
    live.apply("dry", [reading(1, outputs=AT_SPEED), reading(2, at=50.0)])
    plan = plan_zero(live.buses["dry"], lambda unit: unit == 3, 100.0)
    assert list(plan.units) == [4]
    assert plan.left_out == {"Unit 1": "not in REMOTE", "Unit 2": "does not answer", "Unit 3": "blocked"}


def test_with_the_port_closed_nobody_is_told() -> None:
    live = line()
    live.apply("dry", [BusLink(at=100.0, link="closed")])
    assert plan_zero(live.buses["dry"], nobody, 100.0).units == {}
