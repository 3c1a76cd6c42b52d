from __future__ import annotations

import pytest

from bus.contract import BusFigures, BusLink
from bus.messages import term
from tests.app.screens import line, reading, screen


def figures(scan_s: float = 0.3) -> BusFigures:
    return BusFigures(at=100.0, scan_hz=3, scan_s=scan_s, wire_utilisation=0.9, scan_s_with_one_more=0.4)


def test_only_what_changed_is_given() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([reading(1, at=100.2, actual=1199)])
    changed = shown.render("dry", [1], 100.2, include_bus=False)
    assert changed == {
        "dry/1": {"at": "100.20", "actual": "119.9", "deviation": "−0.1", "fill": "0.5995", "off": "0.483"}  # noqa: RUF001
    }
    assert shown.render("dry", [1], 100.2, include_bus=False) == {}


def test_the_worst_cause_is_the_verdict_and_goes() -> None:
    live = line()
    shown = screen(live)
    assert shown.shown["line_summary"]["at"] == ""
    live.buses["dry"].apply([reading(2, at=100.2, inputs=1)])
    changed = shown.render("dry", [2], 100.2, include_bus=False)
    assert {name: changed["line_summary"][name] for name in ("at", "level", "verdict", "counts")} == {
        "at": "/units/dry/2",
        "level": "urgent",
        "verdict": "Unit 2 · Still turning: emergency stop active since 00:01",
        "counts": "1 abnormal",
    }
    assert changed["dry/2"]["status"] == "Still turning: emergency stop active since 00:01"
    live.buses["dry"].apply([reading(2, at=100.4)])
    well = shown.render("dry", [2], 100.4, include_bus=False)["line_summary"]
    assert (well["verdict"], well["at"], well["counts"]) == ("All 2 units at speed", "", "")


def test_the_strip_has_abnormal_units_beside_the_worst() -> None:
    live = line(3)
    shown = screen(live)
    for unit, at, inputs in ((1, 115.0, 2), (2, 135.0, 1), (3, 150.0, 2)):
        live.buses["dry"].apply([reading(unit, at=at - 0.2), reading(unit, at=at, inputs=inputs, actual=0)])
    live.buses["dry"].apply(
        [reading(unit, at=150.2, inputs=inputs, actual=0) for unit, inputs in ((1, 2), (2, 1))]
    )
    changed = shown.render("dry", [1, 2, 3], 150.2, include_bus=False)["line_summary"]
    assert changed["verdict"] == "Unit 2 · Stopped: emergency stop active since 00:02"
    assert changed["strip"] == [
        ["dry/1", "high", "Unit 1", "Stopped: run input off", "since 00:01"],
        ["dry/3", "high", "Unit 3", "Stopped: run input off", "since 00:02"],
    ]


def test_a_unit_does_not_repeat_the_lost_cable_of_its_bus() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([BusLink(at=101.0, link="closed", cause=term("unplugged"))])
    shown.render("dry", [1, 2], 130.0, include_bus=True)
    assert [shown.shown["dry/1"][name] for name in ("link", "level", "cause", "status")] == [
        *("offline", "", ""),
        "Port closed since 00:01: unplugged",
    ]


def test_time_alone_makes_stale_then_offline() -> None:
    shown = screen(line())
    assert shown.render_aged(101.0) == {}
    assert shown.render_aged(102.5)["dry/1"]["link"] == "stale"
    assert shown.render_aged(111.0)["dry/1"]["link"] == "offline"


def test_a_closed_port_is_one_entry_and_not_one_for_each_unit() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([BusLink(at=101.0, link="closed", cause=term("unplugged"))])
    changed = shown.render("dry", [1, 2], 101.0, include_bus=True)
    shown_fields = {name: changed["line_summary"][name] for name in ("verdict", "at", "abnormal")}
    assert shown_fields == {
        "verdict": "dry · Port closed since 00:01: unplugged",
        "at": "/bus/dry",
        "abnormal": "1",
    }
    assert changed["dry"]["link"] == "closed"


def test_the_line_s_figures_are_the_worst_of_all_buses() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([figures()])
    assert shown.render("dry", [], 100.1, include_bus=True)["line_summary"] == {
        "scan": "0.30 s",
        "wire": "90 %",
    }


def test_a_block_is_shown_with_its_reason() -> None:
    shown = screen(line(), blocks={2: "belt off"})
    assert shown.shown["dry/2"]["status"] == "Commands blocked: belt off (anna)"


def test_the_first_paint_has_the_same_texts() -> None:
    shown = screen(line(), "de")
    assert shown.flat()["dry/1.actual"] == "120,0"
    assert shown.flat()["line_summary.verdict"] == "Alle 2 Regler auf Sollwert"


def test_the_strip_has_an_end() -> None:
    live = line(60)
    shown = screen(live)
    live.buses["dry"].apply([reading(n, at=100.2, inputs=1) for n in range(1, 61)])
    changed = shown.render("dry", list(range(1, 61)), 100.2, include_bus=False)
    assert len(changed["line_summary"]["strip"]) == 30
    assert changed["line_summary"]["abnormal"] == "60"


def test_a_bus_without_any_response_is_one_entry() -> None:
    shown = screen(line())
    shown.render_aged(111.0)
    assert shown.shown["line_summary"]["verdict"] == "dry · No unit responds since 00:01"
    assert shown.shown["line_summary"]["level"] == "urgent"
    assert shown.shown["dry/1"]["status"] == "No response since 00:01"


@pytest.mark.parametrize(
    ("readings", "verdict", "german"),
    [
        ([{}, {}], "All 2 units at speed", "Alle 2 Regler auf Sollwert"),
        ([{"commanded": 0, "actual": 0}] * 2, "All 2 units at zero", "Alle 2 Regler auf null"),
        ([{}, {"outputs": 0x40, "actual": 900}], "1 of 2 ramping", "1 von 2 in Rampe"),
        (
            [{}, {"commanded": 0, "actual": 0}],
            "1 of 2 at speed, the others at zero",
            "1 von 2 auf Sollwert, die anderen auf null",
        ),
    ],
)
def test_the_verdict_of_a_normal_line_is_one_text(
    readings: list[dict[str, int]], verdict: str, german: str
) -> None:
    live = line()
    live.buses["dry"].apply([reading(unit, **changes) for unit, changes in enumerate(readings, 1)])
    for tag, text in (("en", verdict), ("de", german)):
        shown = screen(live, tag).shown["line_summary"]
        assert (shown["verdict"], shown["counts"], shown["level"]) == (text, "", "")


@pytest.mark.parametrize(
    ("changes", "verdict", "german"),
    [
        ({}, "1 unit at speed", "1 Regler auf Sollwert"),
        ({"commanded": 0, "actual": 0}, "1 unit at zero", "1 Regler auf null"),
    ],
)
def test_the_verdict_of_one_unit(changes: dict[str, int], verdict: str, german: str) -> None:
    live = line(1)
    live.buses["dry"].apply([reading(1, **changes)])
    assert screen(live).shown["line_summary"]["verdict"] == verdict
    assert screen(live, "de").shown["line_summary"]["verdict"] == german


def test_without_units_the_verdict_reports_it() -> None:
    assert screen(line(0)).shown["line_summary"]["verdict"] == "No unit is configured"


def test_the_first_line_of_a_unit_that_is_well_is_its_state() -> None:
    assert screen(line()).shown["dry/1"]["status"] == "At speed"
    assert screen(line(), "de").shown["dry/1"]["status"] == "Auf Sollwert"


def test_a_ramp_updates_its_unit_and_not_the_line_each_second() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([reading(1, at=101.0, outputs=0x40, actual=200)])
    shown.render("dry", [1], 101.0, include_bus=False)
    live.buses["dry"].apply([reading(1, at=103.0, outputs=0x40, actual=500)])
    changed = shown.render("dry", [1], 103.0, include_bus=False)
    assert changed["dry/1"]["status"] == "Ramping to 120.0, about 4 s left"
    assert "line_summary" not in changed


def test_checks_are_shown_with_the_cause() -> None:
    live = line()
    shown = screen(live)
    live.buses["dry"].apply([reading(1, at=100.2, inputs=2, actual=0)])
    assert (
        shown.render("dry", [1], 100.2, include_bus=False)["dry/1"]["check"]
        == "Check the run contact at the drive"
    )
