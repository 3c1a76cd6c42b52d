"""A condition has one priority: on the tile, in the verdict and in the list of alarms."""

from __future__ import annotations

import re
from itertools import product
from typing import Any

import pytest

from app.core.web.assets import static_dir
from app.line.alarms.alarm import built_in
from app.line.conditions.catalogue import CONDITIONS, STATUS, TILES
from app.line.conditions.condition import MATRIX, PRIORITIES, AlarmPriority, Condition
from app.line.conditions.unit import BY_READING
from app.line.live.bus_live import LiveState
from app.line.live.diagnosis import Cause, abnormal, connection_cause, shown_cause, unit_cause, unit_facts
from app.line.live.fields import cause_texts, check_text
from bus.contract import BusLink, ParameterValue, UnitLink
from bus.instants import UnixTime
from bus.messages import TEXTS, Message
from docs.alarm_table import DOCUMENTS, alarm_table, with_table
from tests.app.screens import AT_SPEED, HEALTHY, REMOTE, RUN, line, reading, screen, translator

NOW = 100.0
CSS = "\n".join(path.read_text(encoding="utf-8") for path in (static_dir() / "css").rglob("*.css"))


def of_alarm(code: str) -> AlarmPriority:
    return built_in(code, "dry").priority


def after(seconds: float = 10.0, **changes: int) -> LiveState:
    """A unit whose readings are like this for some time."""
    live = line()
    steps = [NOW + 0.2 * step for step in range(int(seconds / 0.2) + 1)]
    live.buses["dry"].apply([reading(1, at=at, **changes) for at in steps])
    live.buses["dry"].apply([reading(2, at=NOW + seconds)])
    return live


def cause_of(live: LiveState, now: float = NOW + 10, drifted: str = "", blocked: str = "") -> Cause | None:
    bus = live.buses["dry"]
    why = Message.of("block_by", reason=blocked, who="anna") if blocked else None
    return shown_cause(
        bus, bus.units[1], unit_cause(bus, bus.units[1], now), now, blocked=why, drifted=drifted
    )


@pytest.mark.parametrize(
    ("inputs", "outputs", "actual", "commanded"),
    list(
        product(
            (RUN | HEALTHY, HEALTHY, RUN), (AT_SPEED | REMOTE, REMOTE, AT_SPEED, 0), (1200, 900, 0), (1200, 0)
        )
    ),
)
def test_the_tile_has_the_priority_of_the_alarms_of_the_condition_that_it_names(
    inputs: int, outputs: int, actual: int, commanded: int
) -> None:
    live = after(inputs=inputs, outputs=outputs, actual=actual, commanded=commanded)
    bus, cause = live.buses["dry"], cause_of(live)
    unit = bus.units[1]
    assert unit.reading is not None
    facts = unit_facts(bus, unit, unit.reading)
    held = [row.code for row in BY_READING if row.is_alarm and row.holds(facts)]
    if cause is None or cause.code not in held:
        # A run input that is off comes before the mode, and has no alarm.
        assert held == [] or (cause is not None and cause.code == "run_off")
        return
    assert cause.level == min(map(of_alarm, held), key=PRIORITIES.index)
    live_screen = screen(live)
    live_screen.refresh(NOW + 10)
    assert live_screen.shown["dry/1"]["level"] == cause.level
    assert live_screen.shown["line_summary"]["level"] == (cause.level if cause.level != "low" else "")


def test_every_condition_of_a_reading_is_named_by_some_tile() -> None:
    named = {
        cause.code
        for inputs, outputs, actual in product((RUN | HEALTHY, HEALTHY, RUN), (REMOTE, 0), (900, 0))
        if (cause := cause_of(after(inputs=inputs, outputs=outputs, actual=actual))) is not None
    }
    assert {row.code for row in BY_READING if row.is_alarm} <= named


def test_a_lost_unit_bus_or_worker_has_the_priority_of_its_alarm() -> None:
    live = line()
    bus = live.buses["dry"]
    bus.apply([UnitLink(unit=1, at=NOW, link="offline")])
    assert (found := cause_of(live, NOW)) is not None
    assert (found.code, found.level) == ("unit_offline", of_alarm("unit_offline"))
    bus.apply([BusLink(at=NOW, link="closed")])
    assert (found := connection_cause(bus, NOW)) is not None
    assert (found.code, found.level) == ("port_lost", of_alarm("port_lost"))
    bus.lose_worker(NOW)
    assert (found := connection_cause(bus, NOW)) is not None
    assert (found.code, found.level) == ("worker_lost", of_alarm("worker_lost"))


def test_a_condition_of_parameters_has_the_priority_of_its_alarm() -> None:
    live = line()
    assert (found := cause_of(live, NOW, drifted="#6")) is not None
    assert (found.code, found.level) == ("drift", of_alarm("parameter_drift"))
    live = line(units=3)
    read = {1: 9, 2: 2, 3: 3}
    live.buses["dry"].apply([ParameterValue(unit=n, number=17, at=NOW, raw=own) for n, own in read.items()])
    assert (found := cause_of(live, NOW)) is not None
    assert (found.code, found.level) == ("address_suspect", of_alarm("duplicate_address"))


@pytest.mark.parametrize("priority", PRIORITIES)
def test_every_surface_draws_every_priority(priority: AlarmPriority) -> None:
    (drawn,) = re.findall(rf'(?m)^\[data-is\^="{priority}"\], [^{{}}]*\{{([^}}]*)\}}', CSS)
    assert {"--level", "--level-ink", "--level-text", "--level-shape", "--level-number"} == set(
        re.findall(r"(--[\w-]+):", drawn)
    )
    assert f"--level: var(--{priority});" in drawn
    assert re.findall(rf'\[data-is="{priority}"\][^{{}}]*\{{[^}}]*var\(--{priority}\)', CSS) == []
    assert f'id="{priority}"' in (static_dir() / "icons" / "sprite.svg").read_text(encoding="utf-8")


EVERY_ROW = pytest.mark.parametrize("row", CONDITIONS.values(), ids=lambda row: row.code)
EVERY_ALARM = pytest.mark.parametrize(
    "row", [row for row in CONDITIONS.values() if row.is_alarm], ids=lambda row: row.code
)


@EVERY_ALARM
def test_the_alarm_of_a_condition_is_its_row_in_words(row: Condition[Any]) -> None:
    alarm = built_in(row.code, "dry", 1)
    record, how = alarm.record, alarm.attributes
    words = (alarm.name, record.cause, record.consequence, record.response)
    assert tuple(text.code for text in words if isinstance(text, Message)) == row.texts
    assert all(TEXTS[code] for code in row.texts)
    assert alarm.priority == MATRIX[record.severity, record.time_to_respond] == row.priority
    assert (how.on_delay_s, how.off_delay_s, how.latching, alarm.group) == (
        *(row.tuning.on_delay_s, row.tuning.off_delay_s),
        *(row.latching, row.group),
    )


@pytest.mark.parametrize("language", DOCUMENTS)
def test_the_table_of_the_documentation_is_generated(language: str) -> None:
    """After a change of a row or of its words: ``python -m docs.alarm_table``."""
    text = DOCUMENTS[language].read_text(encoding="utf-8")
    assert alarm_table(language) in text
    assert with_table(text, language) == text


@EVERY_ROW
def test_every_tile_of_a_condition_has_its_priority_and_words(row: Condition[Any]) -> None:
    assert row.tiles or row.is_alarm, "no surface shows it"
    for code in row.tiles:
        assert TILES[code] is row
        found = abnormal(code, params={"why": Message("worker_not_connected"), "mode": "LOCAL"})
        assert found.level == row.priority
        assert cause_texts(found, translator(), UnixTime(0.0)).text
        assert check_text(found, translator()) == TEXTS.get(f"tile_{code}_check", "")


@EVERY_ROW
def test_every_rung_and_event_of_a_condition_has_what_it_needs(row: Condition[Any]) -> None:
    assert (row.rung is not None) == (row in BY_READING)
    assert {*row.since} <= {*STATUS, "turning"}
    assert row.broken is None or row.rung
    if row.event is not None:
        assert {row.event.began, row.event.ended} <= set(TEXTS)
        assert row.event.off != row.event.on


def test_the_rungs_are_in_the_order_in_which_each_needs_the_one_before() -> None:
    rungs = [row.rung for row in BY_READING]
    assert list(dict.fromkeys(rungs)) == ["e-stop", "run", "mode", "link", "ramp"]
