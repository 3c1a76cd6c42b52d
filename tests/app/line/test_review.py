"""What pages show of commands: changes with their ramp, remarks and draws of a review, the plan to zero, the
words of a result."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from app.core.messages import Languages
from app.core.web.arrival import Deadline
from app.errors import Problem
from app.line.commands.limits import Limits
from app.line.commands.review import (
    OutcomeText,
    Ramp,
    by_remark,
    change_of,
    draw_changes,
    leaves_band,
    nudges,
    obstacle_of,
    outcome_of_all,
    outcome_text,
    plan_zero,
    present_setpoint,
    ramp_of,
    ramp_parameters_missing,
    risks_of,
)
from app.line.commands.values import staging_wording, with_names
from app.line.live.bus_live import BusLive, LiveState
from bus.contract import BusLink, ParameterValue, Result, UnitLink, UnitOutcome, Update
from bus.instants import monotonic_now
from bus.messages import Message, term
from bus.settings import BusSettings
from tests.app.screens import AT_SPEED, HEALTHY, RUN, line, reading, translator

NOW = 100.0
KNOWN = Ramp(6, 100, 2.0)


def after(*updates: Update) -> LiveState:
    """The line, after these."""
    live = line()
    live.buses["dry"].apply(updates)
    return live


def remarks(live: LiveState, *, block: str = "", ramp: Ramp | None = KNOWN) -> tuple[str, list[str]]:
    """Return the codes of the remarks about unit 1."""
    bus = live.buses["dry"]
    reason = Message.of("block_by", reason=block, who="anna") if block else None
    obstacle = obstacle_of(bus, bus.units[1], NOW, block=reason)
    risks = risks_of(bus, bus.units[1], NOW, ramp)
    return "" if obstacle is None else obstacle.code, [risk.code for risk in risks]


@pytest.mark.parametrize(
    ("live", "block", "ramp", "expected"),
    [
        (after(), "", KNOWN, ("", [])),
        (after(), "", None, ("", [])),
        (after(), "belt off", KNOWN, ("obstacle_blocked", [])),
        (after(BusLink(at=NOW, link="closed")), "", KNOWN, ("obstacle_no_link", ["risk_stale"])),
        (after(reading(at=50.0)), "", KNOWN, ("obstacle_offline", [])),
        (after(reading(at=96.0)), "", KNOWN, ("", ["risk_stale"])),
        (after(reading(outputs=AT_SPEED)), "", KNOWN, ("obstacle_not_in_remote", [])),
        (after(reading(inputs=RUN)), "", KNOWN, ("", ["risk_estop_active"])),
        (after(reading(inputs=HEALTHY)), "", KNOWN, ("", ["risk_run_off"])),
        (after(), "", Ramp(7, 0, 0.0), ("", ["risk_no_ramp"])),
        (after(), "", Ramp(7, None, None), ("", ["risk_ramp_unknown"])),
        (after(), "", Ramp(7, 50, None), ("", ["risk_ramp_unknown"])),
        (
            after(reading(at=96.0, inputs=0, outputs=0)),
            "belt off",
            Ramp(7, 0, 0.0),
            ("obstacle_blocked", ["risk_stale", "risk_estop_active", "risk_run_off", "risk_no_ramp"]),
        ),
    ],
)
def test_each_fact_has_its_remark(
    live: LiveState, block: str, ramp: Ramp | None, expected: tuple[str, list[str]]
) -> None:
    assert remarks(live, block=block, ramp=ramp) == expected


def test_a_unit_that_never_responded_has_only_that_remark() -> None:
    live = line()
    live.buses["dry"].units[1].reading = None
    assert remarks(live) == ("obstacle_offline", [])


def test_a_new_setpoint_discards_another_that_is_staged() -> None:
    bus = after().buses["dry"]
    bus.units[1].staged = 1230
    assert [risk.code for risk in risks_of(bus, bus.units[1], NOW, KNOWN, 1200)] == ["risk_staged"]
    assert risks_of(bus, bus.units[1], NOW, KNOWN, 1230) == ()


def test_staging_what_is_commanded_is_recorded_as_discarding_what_is_staged() -> None:
    bus = after().buses["dry"]
    assert staging_wording(bus, 1, 1200).what.code == "event_stage_speed"
    bus.units[1].staged = 1230
    found = staging_wording(bus, 1, 1200)
    assert (found.what.code, found.old_raw, found.new_raw) == ("event_discard_staged", 1230, 1200)
    assert staging_wording(bus, 1, 1210).what.code == "event_stage_speed"


def test_one_remark_names_all_its_units() -> None:
    offline, local = Message("obstacle_offline"), Message("obstacle_not_in_remote")
    found = by_remark([("A", local), ("B", offline), ("C", local)])
    assert found == [(local, ["A", "C"]), (offline, ["B"])]


def unblocked(_unit: int) -> str:
    return ""


def test_every_unit_that_can_take_it_does() -> None:
    plan = plan_zero(line().buses["dry"], unblocked, 100.0)
    assert plan.units == {1: "Unit 1", 2: "Unit 2"}
    assert plan.left_out == plan.risks == []
    assert plan.seconds == 12.0


def test_a_ramp_that_is_not_known_is_counted_and_no_remark() -> None:
    live = line()
    live.buses["dry"].apply([ParameterValue(unit=2, number=7, at=1, raw=None, available=False)])
    plan = plan_zero(live.buses["dry"], unblocked, 100.0)
    assert (plan.risks, plan.seconds, plan.unknown) == ([], 12.0, 1)


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
    assert [(name, str(reason)) for name, reason in plan.left_out] == [
        ("Unit 1", "not in REMOTE; it keeps running at 120.0 m/min"),
        ("Unit 2", "does not respond"),
        ("Unit 3", "commands blocked: belt off; it keeps running at 120.0 m/min"),
    ]


def at_120(units: int = 4, **keys: object) -> BusLive:
    """Every unit at 120.0 m/min, one web."""
    bus = line(units).buses["dry"]
    settings = bus.settings.model_dump(exclude_unset=True) | keys
    bus.seams = BusSettings.model_validate(settings).seams
    return bus


def texts(bus: BusLive, setpoints: dict[int, int], tag: str = "en") -> list[tuple[str, bool]]:
    return [(Languages()[tag].t(each.text), each.is_out) for each in draw_changes(bus, setpoints)]


BANDED = {"draw_percent": ["-0.5", "2.0"]}


def test_a_neighbor_that_stays_is_named_with_its_speed_and_the_draw() -> None:
    assert texts(at_120(**BANDED), {2: 1140}) == [
        (
            "Unit 1 stays at 120.0 m/min: draw of Unit 2 \N{MINUS SIGN}5.0 % "
            "instead of \N{PLUS-MINUS SIGN}0.0 %, outside its band of \N{MINUS SIGN}0.5 to 2.0 %",
            True,
        ),
        (
            "Unit 3 stays at 120.0 m/min: draw +5.3 % "
            "instead of \N{PLUS-MINUS SIGN}0.0 %, outside its band of \N{MINUS SIGN}0.5 to 2.0 %",
            True,
        ),
    ]
    assert texts(at_120(**BANDED), {3: 1300}, "de")[0] == (
        "Unit 2 bleibt bei 120,0 m/min: Verzug von Unit 3 +8,3 % statt \N{PLUS-MINUS SIGN}0,0 %,"
        " außerhalb seines Bandes von \N{MINUS SIGN}0,5 bis 2,0 %",
        True,
    )


def test_a_step_out_of_a_band_is_told_from_one_towards_it() -> None:
    bus = at_120(**BANDED)
    assert not leaves_band(bus, {2: 1201})
    assert leaves_band(bus, {2: 1300})
    assert leaves_band(bus, {2: 1140})
    assert not leaves_band(at_120(), {2: 1300})
    bus.apply([reading(2, commanded=1300, actual=1300)])
    assert not leaves_band(bus, {2: 1290}), "towards the band"
    assert leaves_band(bus, {2: 1301})
    assert not leaves_band(bus, {4: 1201}), "a draw that is out already, of units that stay"


def test_without_a_band_a_changed_draw_is_stated_quietly() -> None:
    assert texts(at_120(), {4: 1212}) == [
        ("Unit 3 stays at 120.0 m/min: draw of Unit 4 +1.0 % instead of \N{PLUS-MINUS SIGN}0.0 %", False)
    ]


def test_two_neighbors_of_a_change_have_a_draw_to_each_other() -> None:
    assert texts(at_120(3, **BANDED), {1: 1200, 2: 1300, 3: 1300}) == [
        (
            "draw of Unit 2 to Unit 1: +8.3 % instead of "
            "\N{PLUS-MINUS SIGN}0.0 %, outside its band of \N{MINUS SIGN}0.5 to 2.0 %",
            True,
        )
    ]


@given(st.integers(1, 83))
def test_a_line_that_changes_as_one_has_nothing_to_state(factor: int) -> None:
    assert texts(at_120(**BANDED), dict.fromkeys(range(1, 5), 1200 * factor)) == []


def test_of_followers_standing_units_and_unknown_speeds_nothing_is_stated() -> None:
    bus = at_120(**BANDED)
    bus.apply([ParameterValue(unit=2, number=8, at=100.0, raw=1), reading(4, 100.0, 0, 0)])
    assert texts(bus, {3: 1300}) == []
    bus.units[2].parameters.pop(8)
    bus.units[2].reading = None
    assert texts(bus, {3: 1300}) == []


def test_beside_a_standing_unit_the_draws_that_stay_as_commanded_are_one_line_and_last() -> None:
    bus = at_120()
    bus.apply([reading(2, 100.0, 1200, 0)])
    assert texts(bus, {1: 1212, 2: 1212}) == [
        ("Unit 3 stays at 120.0 m/min: draw \N{MINUS SIGN}1.0 %", False),
        ("draw stays as commanded: Unit 2", False),
    ]


def test_an_offline_neighbor_keeps_its_speed() -> None:
    bus = at_120(**BANDED)
    bus.apply([UnitLink(unit=4, at=100.0, link="offline")])
    assert len(texts(bus, {3: 1300})) == 2


@pytest.mark.parametrize("setpoints", [{}, {2: 1200}, {2: 0}])
def test_what_changes_no_draw_is_not_stated(setpoints: dict[int, int]) -> None:
    assert texts(at_120(**BANDED), setpoints) == []


@pytest.mark.parametrize(
    ("result", "tone", "text"),
    [
        (Result(id="1", at=0, outcome="verified", read_back=1200), "good", "verified: reads 1200"),
        (Result(id="1", at=0, outcome="verified"), "good", "verified"),
        (Result(id="1", at=0, outcome="acknowledged"), "good", "acknowledged by the unit"),
        (
            Result(id="1", at=0, outcome="refused", unit_error=0x80),
            "bad",
            "rejected by the unit: unit is not in REMOTE mode",
        ),
        (Result(id="1", at=0, outcome="unverified", read_back=1198), "unknown", "reads 1198 instead"),
        (Result(id="1", at=0, outcome="unverified"), "unknown", "no response: the result is not known"),
        (
            Result(id="1", at=0, outcome="unverified", message=Message.of("nothing_sent", reason=term("no"))),
            "bad",
            "no; nothing was sent",
        ),
        (Result(id="1", at=0, outcome="not_sent"), "bad", ("not sent: the bus was busy until the deadline")),
        (Result(id="1", at=0, outcome="bus_closed"), "bad", "not sent: there is no link to the bus"),
        (Result(id="1", at=0, outcome="invalid", message=term("no")), "bad", "no"),
    ],
)
def test_every_outcome_has_its_words(result: Result, tone: str, text: str) -> None:
    outcome = outcome_text(result)
    assert (outcome.tone, str(outcome.text)) == (tone, text)


def test_the_result_of_several_names_each_unit_that_failed_with_its_own_cause() -> None:
    silent = UnitOutcome(5, "unverified", Message.of("unit_no_response", unit=5))
    good, failed = (
        ("Nip", OutcomeText("good", term("verified"))),
        OutcomeText("unknown", term("reads 120.2 instead")),
    )

    def text(rows: dict[int, tuple[str, OutcomeText]], n: int, **more: Any) -> str:
        result = Result("id", 0.0, "unverified", units=[UnitOutcome(4, "verified"), silent])
        found = outcome_of_all(replace(result, **more), rows, n)
        return f"{found.tone}: {found.text}"

    assert text({4: good}, 1) == "good: verified"
    assert (
        text({4: good, 5: ("Dryer", failed)}, 2)
        == "unknown: 1 of 2 units verified; Dryer: reads 120.2 instead"
    )
    many = {4: good} | {unit: (f"Dryer {unit}", failed) for unit in range(5, 10)}
    names = "Dryer 5, Dryer 6, Dryer 7"
    assert text(many, 6) == f"unknown: 1 of 6 units verified; {names}: reads 120.2 instead; 2 more"
    refused = UnitOutcome(5, "refused", unit_error=0x80)
    row = {5: ("Dryer", outcome_text(refused))}
    not_in_remote = "bad: Dryer: rejected by the unit: unit is not in REMOTE mode"
    assert text(row, 2, outcome="refused", units=[refused], unit_error=0x80) == not_in_remote


def test_a_withdrawn_part_of_a_change_is_shown_in_the_reader_s_language() -> None:
    taken_back = Message.of("staged_withdrawn", present=1200)
    part = UnitOutcome(unit=3, outcome="not_sent", message=taken_back)
    assert outcome_text(part).text == taken_back
    assert "vorbereitet; nicht ausgeführt" in translator("de").t(outcome_text(part).text)


def test_a_page_names_the_units_and_shows_their_speeds_in_what_the_worker_says() -> None:
    bus = line().buses["dry"]
    name = bus.units[1].settings.name
    reads = Message.of("unit_may_hold", unit=1, reason=Message.of("speed_reads", value=1100), raw=1200)
    left = Message.of("no_unit_changed_staged_left", reason=reads, units=[1, 250])
    assert str(left).startswith("unit 1: its commanded speed reads 1100; 1200 may still")
    assert str(with_names(left, bus)) == (
        f"{name}: its commanded speed reads 110.0 m/min; 120.0 m/min may still be staged in it; "
        f"no unit was changed; may still be staged in {name}, 250"
    )
    taken_back = Message.of("staged_withdrawn", present=1200)
    assert "(120.0 m/min)" in str(with_names(taken_back, bus, 1))
    silent = Message.of("no_unit_changed", reason=Message.of("unit_no_response", unit=1))
    in_german = translator("de").t(with_names(silent, bus))
    assert in_german.endswith("hat nicht geantwortet; kein Regler wurde geändert")


def test_why_a_change_was_not_sent_is_shown_and_not_a_busy_bus() -> None:
    reason = Message.of("no_unit_changed", reason=Message.of("outsider_unknown", unit=5))
    assert outcome_text(Result(id="1", at=0, outcome="not_sent", message=reason)).text == reason


def test_a_refusal_before_sending_is_shown_in_the_reader_s_language() -> None:
    with pytest.raises(Problem) as late:
        Deadline(monotonic_now() - 4, 2.0).refuse_passed()
    text = translator("de").t(late.value.message)
    assert text.startswith("der Befehl kam zu spät: er ist 4,0 s alt, erlaubt waren 2 s")


FREE = Limits()


def test_a_change_has_its_start_target_and_duration() -> None:
    bus = line().buses["dry"]
    up = change_of(bus, bus.units[1], 1600, FREE, NOW)
    assert (str(up.old), str(up.new), up.measure, up.ramp) == ("120.0", "160.0", "m/min", Ramp(6, 100, 2.0))
    down = change_of(bus, bus.units[1], 200, FREE, NOW)
    assert down.ramp == Ramp(7, 200, 10.0)
    assert (up.obstacle, up.risks) == (None, ())


def test_a_unit_that_is_held_starts_its_next_ramp_from_standstill() -> None:
    bus = after(reading(1, inputs=0x02)).buses["dry"]
    change = change_of(bus, bus.units[1], 1600, FREE, NOW)
    assert (str(change.old), change.ramp) == ("120.0", Ramp(6, 100, 8.0))


def test_a_ramp_that_is_not_known_is_not_guessed() -> None:
    live = line()
    live.buses["dry"].apply([ParameterValue(unit=1, number=6, at=1, raw=None, available=False)])
    bus = live.buses["dry"]
    assert ramp_of(bus.units[1], 1200, 1600) == Ramp(6, None, None)
    assert ramp_of(bus.units[1], None, 1600) == Ramp(6, None, None)
    del bus.units[1].parameters[6]
    assert ramp_parameters_missing(bus.units[1]) == [6]


def test_without_its_span_a_ramp_of_nothing_is_still_known() -> None:
    live = line()
    live.buses["dry"].apply([ParameterValue(unit=1, number=n, at=1, raw=raw) for n, raw in ((2, 0), (6, 0))])
    unit = live.buses["dry"].units[1]
    assert ramp_of(unit, 1200, 1600) == Ramp(6, 0, 0.0)
    assert ramp_of(unit, 1200, 800) == Ramp(7, 200, None)
    assert ramp_of(unit, 1200, 1200) is None


def test_the_range_is_shown_with_the_change() -> None:
    bus = line().buses["dry"]
    free = change_of(bus, bus.units[1], 1600, FREE, NOW)
    assert (str(free.lowest), str(free.highest)) == ("0.0", "200.0")
    limited = change_of(bus, bus.units[1], 1600, Limits(lowest=100, highest=2500), NOW)
    assert (str(limited.lowest), str(limited.highest)) == ("10.0", "250.0")


def test_a_follower_s_setpoint_is_its_ratio() -> None:
    live = line()
    live.buses["dry"].apply(
        [ParameterValue(unit=1, number=8, at=1, raw=1), ParameterValue(unit=1, number=37, at=1, raw=10250)]
    )
    bus = live.buses["dry"]
    assert present_setpoint(bus, bus.units[1]) == 10250
    change = change_of(bus, bus.units[1], 10300, FREE, NOW)
    assert (str(change.old), str(change.new), change.measure, change.ramp) == ("1.0250", "1.0300", "", None)


def test_nudges_suit_the_span() -> None:
    live = line()
    assert nudges(live.buses["dry"].units[1]) == (2, 20)
    live.buses["dry"].apply([ParameterValue(unit=1, number=2, at=1, raw=50), reading(1)])
    assert nudges(live.buses["dry"].units[1]) == (1, 1)
    del live.buses["dry"].units[1].parameters[2]
    assert nudges(live.buses["dry"].units[1]) == ()
