"""Why a unit departed from its golden set: a command from here, or a change at the panel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.core.database import Database
from app.engineering.sets.drift import BusDrift
from app.engineering.sets.model import ParameterRow, ParameterSet, UnitRows
from app.engineering.sets.store import SetStore
from app.line.live.sources import Drifted
from app.people.audit.log import EventLog
from bus.catalogue.parameters import PARAMETERS
from bus.contract import ParameterValue
from bus.messages import Message
from tests.app.played_commands import a_bus
from tests.app.screens import translator

GOLDEN_READ, NOW = 1000.0, 51_600.0
"""1970-01-01 14:20 UTC is ``NOW``."""


class Scene:
    def __init__(self, folder: Path) -> None:
        self.live = a_bus()
        self.database = Database(folder / "store.db")
        self.now = NOW
        self.events = EventLog(self.database, lambda: self.now)
        self.store = SetStore(self.database)
        self.drift = BusDrift(self.live.buses["dry-end"], self.store, self.events)
        self.notified: list[int] = []
        self.drift.on_change(self.notified.append)

    async def golden(self) -> None:
        rows = {number: ParameterRow(number, 0, read_at=GOLDEN_READ) for number in PARAMETERS}
        unit = UnitRows(1, "Unwind", rows)
        kept = await self.store.save(ParameterSet("dry-end", GOLDEN_READ, "anna", "by hand", (unit,)))
        await self.store.mark_golden("dry-end", [1], kept.id, "anna", GOLDEN_READ)
        await self.drift.load()

    def reads(self, number: int, raw: int) -> None:
        self.live.buses["dry-end"].apply([ParameterValue(unit=1, number=number, at=self.now, raw=raw)])

    async def sent(self, who: str, number: int, raw: int | None, outcome: str | None = "verified") -> None:
        fields: dict[str, Any] = {"who": who, "origin": "api", "bus": "dry-end", "unit": 1, "new_raw": raw}
        what = Message.of("event_write_parameter", number=number, called=PARAMETERS[number].name)
        await self.events.record(kind="command", what=what, outcome=outcome, **fields)

    def key(self) -> str:
        return self.drift.summary(1, translator(), NOW).key

    async def text(self, tag: str = "en") -> str:
        await self.drift.traced(1)
        return self.drift.summary(1, translator(tag), NOW).words


@pytest.fixture
async def scene(tmp_path: Path) -> Scene:
    made = Scene(tmp_path)
    await made.golden()
    return made


async def test_a_command_is_named_with_its_hour_and_a_hand_at_the_panel_too(scene: Scene) -> None:
    assert await scene.text() == ""
    await scene.sent("anna", 12, 21)
    scene.reads(12, 21)
    assert (
        await scene.text()
        == "Up to Speed Tolerance (parameter 12) differs from the golden set: changed by anna 14:20"
    )
    assert (
        await scene.text("de")
        == "Toleranz für „auf Sollwert“ (Parameter 12) weicht vom Referenzsatz ab: geändert von anna 14:20"
    )
    scene.reads(6, 33)
    scene.reads(7, 34)
    assert (
        await scene.text()
        == "3 values differ from the golden set: 1 changed by anna 14:20, 2 changed at the keypad"
    )
    scene.reads(12, 0)
    assert await scene.text() == "2 values differ from the golden set, changed at the keypad"
    assert 1 in scene.notified


async def test_the_hand_that_came_after_the_command_is_the_one(scene: Scene) -> None:
    await scene.sent("anna", 12, 21)
    scene.reads(12, 21)
    scene.reads(12, 22)
    assert (
        await scene.text()
        == "Up to Speed Tolerance (parameter 12) differs from the golden set, changed at the keypad"
    )
    await scene.sent("berta", 12, 22)
    scene.reads(12, 22)
    assert (
        await scene.text()
        == "Up to Speed Tolerance (parameter 12) differs from the golden set: changed by berta 14:20"
    )


@pytest.mark.parametrize("outcome", ["refused", "invalid", "not_sent"])
async def test_a_command_that_was_not_carried_out_changed_nothing(scene: Scene, outcome: str) -> None:
    await scene.sent("anna", 12, 21)
    await scene.sent("berta", 12, 99, outcome)
    scene.reads(12, 21)
    assert "by anna" in await scene.text()
    scene.reads(12, 99)
    assert (
        await scene.text()
        == "Up to Speed Tolerance (parameter 12) differs from the golden set, changed at the keypad"
    )


async def test_number_1_is_not_number_12_and_a_command_older_than_the_set_is_none(scene: Scene) -> None:
    await scene.sent("anna", 12, 21)
    scene.now = GOLDEN_READ - 1
    await scene.sent("anna", 1, 21)
    scene.reads(1, 21)
    assert (
        await scene.text()
        == "Maximum Motor Speed (parameter 1) differs from the golden set, changed at the keypad"
    )


async def test_the_last_write_of_the_operator_password_is_named_unseen(
    scene: Scene,
) -> None:
    scene.reads(21, 4711)
    assert (
        await scene.text()
        == "Operator Password (parameter 21) differs from the golden set, changed at the keypad"
    )
    fields: dict[str, Any] = {"who": "anna", "origin": "api", "bus": "dry-end", "unit": 1}
    what = Message.of("event_write_parameter", number=21, called="Operator Password")
    await scene.events.record(kind="command", what=what, outcome="verified", **fields)
    scene.reads(21, 4712)
    assert "by anna" in await scene.text()


@pytest.mark.parametrize(("old_raw", "is_named"), [(0, True), (5, False), (None, False)])
async def test_an_event_without_messages_is_known_by_its_values_not_by_its_text(
    scene: Scene, old_raw: int | None, is_named: bool
) -> None:
    fields: dict[str, Any] = {
        "who": "anna",
        "origin": "api",
        "bus": "dry-end",
        "unit": 1,
        "outcome": "verified",
    }
    await scene.events.record(kind="command", what="any text", old_raw=old_raw, new_raw=21, **fields)
    scene.reads(12, 21)
    assert ("by anna" in await scene.text()) is is_named


async def test_after_a_restart_the_events_still_show_the_cause(scene: Scene) -> None:
    await scene.sent("anna", 12, 21)
    live = a_bus()
    again = BusDrift(live.buses["dry-end"], scene.store, scene.events)
    await again.load()
    live.buses["dry-end"].apply([ParameterValue(unit=1, number=41, at=NOW, raw=7)])
    assert again.unread(1) == 40, "a parameter beyond the list is none of the forty"
    live.buses["dry-end"].apply([ParameterValue(unit=1, number=12, at=NOW + 5, raw=21)])
    [one] = await again.traced(1)
    assert one.change is not None
    assert (one.change["who"], one.traced) == ("anna", True)
    await again.background.close()


async def test_the_list_on_the_units_page_has_another_key_when_its_text_changes(scene: Scene) -> None:
    keys = [scene.key()]
    for number, raw in ((7, 0), (7, 61), (7, 62), (12, 5)):
        scene.reads(number, raw)
        keys.append(scene.key())
    await scene.sent("erik", 12, 5)
    await scene.text()
    keys.append(scene.key())
    assert len(set(keys)) == len(keys)
    scene.reads(12, 5)
    await scene.text()
    assert scene.key() == keys[-1]
    assert scene.drift.summary(2, translator(), NOW) == Drifted()
