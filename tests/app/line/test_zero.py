from __future__ import annotations

from app.line.commands.review import plan_zero
from bus.contract import BusLink, ParameterValue
from tests.app.screens import AT_SPEED, HEALTHY, line, reading


def unblocked(_unit: int) -> str:
    return ""


def test_every_unit_that_can_take_it_does() -> None:
    plan = plan_zero(line().buses["dry"], unblocked, 100.0)
    assert plan.units == {1: "Unit 1", 2: "Unit 2"}
    assert plan.left_out == plan.risks == []
    assert plan.seconds == 12.0


def test_followers_come_down_with_their_master() -> None:
    live = line()
    live.buses["dry"].apply([ParameterValue(unit=2, number=8, at=1, raw=1)])
    plan = plan_zero(live.buses["dry"], unblocked, 100.0)
    assert (list(plan.units), plan.followers, plan.left_out) == ([1], 1, [])


def test_each_that_cannot_take_it_has_its_reason() -> None:
    live = line(4)
    live.buses["dry"].apply([reading(1, outputs=AT_SPEED), reading(2, at=50.0)])
    plan = plan_zero(live.buses["dry"], lambda unit: "belt off" if unit == 3 else "", 100.0)
    assert list(plan.units) == [4]
    assert [(name, reason.code) for name, reason in plan.left_out] == [
        ("Unit 1", "obstacle_not_in_remote"),
        ("Unit 2", "obstacle_offline"),
        ("Unit 3", "obstacle_blocked"),
    ]


def test_with_the_port_closed_all_are_left_out() -> None:
    live = line()
    live.buses["dry"].apply([BusLink(at=100.0, link="closed")])
    assert plan_zero(live.buses["dry"], unblocked, 100.0).units == {}


def test_a_unit_without_a_ramp_and_one_that_does_not_run_are_named() -> None:
    live = line()
    live.buses["dry"].apply([ParameterValue(unit=1, number=7, at=1, raw=0), reading(2, inputs=HEALTHY)])
    plan = plan_zero(live.buses["dry"], unblocked, 100.0)
    assert [(name, risk.code) for name, risk in plan.risks] == [
        ("Unit 1", "risk_no_ramp"),
        ("Unit 2", "risk_run_off"),
    ]
