from __future__ import annotations

from app.live.motions import watch_motions
from bus.contract import BusFigures, BusLink
from tests.app.screens import line, reading, screen, voice


def figures(scan_s: float = 0.3) -> BusFigures:
    return BusFigures(at=100.0, scan_hz=3, scan_s=scan_s, wire_utilisation=0.9, scan_s_with_one_more=0.4)


def test_only_what_changed_is_given() -> None:
    live = line()
    shown = screen(live)
    live.apply("dry", [reading(1, at=100.2, actual=1199)])
    changed = shown.see("dry", [1], 100.2, whole_bus=False)
    assert changed == {
        "dry/1": {"at": "100.20", "actual": "119.9", "deviation": "−0.1", "fill": "0.5995", "off": "0.483"}  # noqa: RUF001
    }
    assert shown.see("dry", [1], 100.2, whole_bus=False) == {}


def test_a_trouble_comes_into_the_strip_and_goes() -> None:
    live = line()
    shown = screen(live)
    assert shown.shown["whole_line"]["strip"] == ""
    live.apply("dry", [reading(2, at=100.2, inputs=1)])
    changed = shown.see("dry", [2], 100.2, whole_bus=False)
    assert changed["whole_line"]["strip"] == "dry/2\turgent\tUnit 2\te-stop input active\t"
    assert (changed["whole_line"]["level"], changed["whole_line"]["verdict"]) == ("urgent", "1 needs a look")
    live.apply("dry", [reading(2, at=100.4)])
    assert shown.see("dry", [2], 100.4, whole_bus=False)["whole_line"]["strip"] == ""


def test_the_strip_says_since_when_where_the_beginning_was_seen() -> None:
    live = line()
    shown = screen(live)
    bus = live.buses["dry"]
    for unit, at in ((1, 115.0), (2, 121.0)):
        live.apply("dry", [reading(unit, at=at, inputs=1)])
        watch_motions(shown.motions, "dry", bus, [unit], 0.2)
    changed = shown.see("dry", [1, 2], 121.0, whole_bus=False)
    said = [entry.split("\t")[4] for entry in changed["whole_line"]["strip"].split("\n")]
    assert said == [voice().t("since {time}", time=voice().formats.since(at, 121.0)) for at in (115.0, 121.0)]
    assert said[0] != said[1]


def test_a_unit_says_nothing_of_a_cable_that_its_bus_has_lost() -> None:
    live = line()
    shown = screen(live)
    live.apply("dry", [BusLink(at=101.0, link="closed", cause="unplugged")])
    shown.see("dry", [1, 2], 130.0, whole_bus=True)
    assert [shown.shown["dry/1"][name] for name in ("link", "level", "trouble")] == ["offline", "", ""]


def test_time_alone_makes_stale_then_offline() -> None:
    shown = screen(line())
    assert shown.settle(101.0) == {}
    assert shown.settle(102.5)["dry/1"]["link"] == "stale"
    assert shown.settle(111.0)["dry/1"]["link"] == "offline"


def test_a_closed_port_is_one_entry_and_not_one_for_each_unit() -> None:
    live = line()
    shown = screen(live)
    live.apply("dry", [BusLink(at=101.0, link="closed", cause="unplugged")])
    changed = shown.see("dry", [1, 2], 101.0, whole_bus=True)
    assert changed["whole_line"]["strip"] == "dry\turgent\tdry\tthe port is closed: unplugged\tsince 00:01"
    assert changed["dry"]["link"] == "closed"


def test_the_line_s_figures_are_the_worst_of_all_buses() -> None:
    live = line()
    shown = screen(live)
    live.apply("dry", [figures()])
    assert shown.see("dry", [], 100.1, whole_bus=True)["whole_line"] == {"scan": "0.30 s", "wire": "90 %"}


def test_a_block_is_shown_with_its_reason() -> None:
    shown = screen(line(), blocks={2: "belt off (anna)"})
    assert shown.shown["dry/2"]["trouble"] == "blocked: belt off (anna)"


def test_the_first_paint_has_the_same_texts() -> None:
    shown = screen(line(), "de")
    assert shown.flat()["dry/1.actual"] == "120,0"
    assert shown.flat()["whole_line.verdict"] == "Alle 2 Regler auf Drehzahl"


def test_the_strip_has_an_end() -> None:
    live = line(60)
    shown = screen(live)
    live.apply("dry", [reading(n, at=100.2, inputs=1) for n in range(1, 61)])
    changed = shown.see("dry", list(range(1, 61)), 100.2, whole_bus=False)
    assert len(changed["whole_line"]["strip"].split("\n")) == 30
    assert changed["whole_line"]["troubles"] == "60"


def test_a_bus_on_which_no_unit_answers_is_one_entry() -> None:
    shown = screen(line())
    shown.settle(111.0)
    strip = shown.shown["whole_line"]["strip"].split("\t")
    assert strip[:4] == ["dry", "urgent", "dry", "no unit answers"]
    assert shown.shown["dry/1"]["trouble"] == "no answer"
