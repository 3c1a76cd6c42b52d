"""All lines in the memory of a server: their age, their order, and the words on a tile."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import pytest

from app.conditions.priority import PRIORITIES, AlarmPriority
from app.live.diagnosis.cause import Level
from app.sites.board import FORGOTTEN_AFTER_S, STALE_AFTER_S, LineBoard, LineOnBoard
from app.sites.fleet import Fleet
from app.sites.summary import CauseSummary, LineSummary, end_notice, notices
from app.sites.tile import outline, tile_fields
from bus.messages import Message
from tests.app.screens import translator


def summary(
    bus: str, level: Level = "", server: str = "app-2", epoch: int = 1, waiting: int = 0
) -> LineSummary:
    cause = CauseSummary("unit_offline", 10.0) if level else None
    counts: dict[AlarmPriority, int] = {"high": waiting} if waiting else {}
    return LineSummary(
        bus,
        "Mill 7",
        server,
        epoch,
        level,
        Message.of("line_at_speed", n=8),
        8,
        {"online": 8, "at_speed": 7, "ramping": 1},
        counts,
        counts,
        place="Nip" if level else "",
        cause=cause,
        alarm=Message.of("line_alarm_at", place="Nip", name="Slow") if waiting else None,
        alarm_priority="high" if waiting else "",
        scan_hz=4.56,
        speeds=[None, 100.0, 110.5],
    )


@dataclass
class Scene:
    """A board on a clock that the test sets."""

    configured: tuple[str, ...] = ()
    own: list[LineSummary] = field(default_factory=list)
    now: float = 1000.0

    def __post_init__(self) -> None:
        self.board = LineBoard(self.configured, lambda: self.own, lambda: self.now)

    def report(self, *lines: LineSummary) -> None:
        for text in notices("app-2", lines):
            self.board.take(text)

    def line(self, bus: str) -> LineOnBoard:
        return next(line for line in self.board.lines() if line.bus == bus)


def test_the_worst_line_comes_first() -> None:
    scene = Scene(("never",))
    lines = [summary(name, name) for name in PRIORITIES]
    scene.report(*reversed(lines), summary("well"), summary("alarmed", waiting=2))
    assert [line.bus for line in scene.board.lines()] == [
        *("urgent", "high", "never", "medium", "low", "alarmed", "well")
    ]


def test_a_server_that_stops_reporting_makes_its_lines_stale_and_never_well() -> None:
    scene = Scene(own=[summary("here", server="app-1")])
    scene.report(summary("there"), summary("worse", "urgent"))
    assert not scene.line("there").is_stale
    scene.now += STALE_AFTER_S + 2
    assert [line.bus for line in scene.board.lines()] == ["worse", "there", "here"]
    there = tile_fields(scene.line("there"), translator(), scene.now)
    assert (there["level"], there["quality"]) == ("high", "stale")
    assert there["verdict"] == "No report from app-2 for 5 s"
    assert there["last"] == "Last reported: All 8 units at speed"
    worse = tile_fields(scene.line("worse"), translator("de"), scene.now)
    assert worse["level"] == "urgent"
    assert worse["verdict"] == "Seit 5 s keine Meldung von app-2"
    assert tile_fields(scene.line("here"), translator(), scene.now)["quality"] == "live"
    scene.report(summary("there"))
    assert not scene.line("there").is_stale


@pytest.mark.parametrize(
    ("age_s", "words"),
    [(4, "4 s"), (119.9, "119 s"), (120, "2 min"), (7199, "119 min"), (7200, "2 h"), (80_000, "22 h")],
)
def test_the_age_in_words(age_s: float, words: str) -> None:
    line = LineOnBoard("a", summary("a"), age_s)
    assert tile_fields(line, translator(), 100.0)["verdict"] == f"No report from app-2 for {words}"


def test_a_server_that_ends_makes_its_lines_stale_at_once() -> None:
    scene = Scene()
    scene.report(summary("there"))
    scene.board.take(end_notice("app-2"))
    scene.board.take(end_notice("app-3"))
    assert scene.line("there").is_stale
    assert tile_fields(scene.line("there"), translator(), 0.0)["verdict"] == "app-2 has stopped, 0 s ago"
    scene.report(summary("there", epoch=2))
    assert not scene.line("there").is_stale


def test_a_former_home_does_not_overwrite_the_present_one() -> None:
    scene = Scene()
    scene.report(summary("line", server="app-3", epoch=5))
    scene.report(summary("line", "urgent", epoch=4))
    assert scene.line("line").summary == summary("line", server="app-3", epoch=5)
    scene.now += STALE_AFTER_S + 1
    scene.report(summary("line", "urgent", epoch=4))
    assert scene.line("line").summary == summary("line", "urgent", epoch=4)


def test_a_line_that_no_server_has_reported_is_there() -> None:
    scene = Scene(("coater",))
    fields = tile_fields(scene.line("coater"), translator(), 0.0)
    assert (fields["level"], fields["quality"]) == ("high", "stale")
    assert fields["verdict"] == "No server reports this line"
    assert not scene.board.is_fleet()
    scene.report(summary("other"))
    assert scene.board.is_fleet()


def test_a_line_without_a_report_for_a_day_is_forgotten() -> None:
    scene = Scene()
    scene.report(summary("old"))
    scene.now += FORGOTTEN_AFTER_S + 1
    assert scene.board.lines() == []


def test_what_cannot_be_read_changes_nothing() -> None:
    scene = Scene()
    scene.board.take('{"server": "x"}')
    scene.board.take("\x00")
    scene.board.take('{"server": "x", "lines": [{"bus": "a"}]}')
    assert scene.board.lines() == []


def test_the_words_of_a_line() -> None:
    fields = tile_fields(LineOnBoard("a", summary("a", "high", waiting=1), 0.5), translator("de"), 100.0)
    assert fields["place"] == "Nip"
    assert fields["verdict"].startswith("Keine Antwort seit")
    assert fields["counts"] == "8/8 aktuell · 7 auf Sollwert · 1 in Rampe"
    assert fields["alarm"] == "Nip · Slow"
    assert (fields["alarm_mark"], fields["alarms"]) == ("high", "1 hoch · 1 zu quittieren")
    assert (fields["scan"], fields["speed"], fields["home"]) == ("4,6", "110,5", "app-2")


def test_the_outline_of_a_speed() -> None:
    assert outline([]) == outline([None]) == ""
    assert outline([5.0, 5.0]).startswith("M236 20.0L240 20.0")
    assert outline([0.0, None, 10.0]).count("M") == 2
    assert outline([1000.0, 1000.5]) == "M236 20.4L240 19.6", "noise does not look like movement"


def test_only_what_has_changed_is_sent_and_put_into_words() -> None:
    scene = Scene()
    fleet = Fleet(scene.board, lambda: 100.0)
    lines = [summary(f"line-{number}") for number in range(3)]
    scene.report(*lines)
    assert len(fleet.changes(translator())) == 3
    scene.report(*lines)
    assert fleet.changes(translator()) == {}
    scene.report(msgspec.structs.replace(lines[1], speeds=[1.0]))
    changed = fleet.changes(translator())
    assert list(changed) == ["line_of/line-1"]
    assert set(changed["line_of/line-1"]) == {"speed", "spark"}
    fleet.forget("en")
    assert len(fleet.changes(translator())) == 3
