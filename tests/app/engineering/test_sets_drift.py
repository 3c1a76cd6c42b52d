"""The difference of two sets and the drift of units, who caused it, and the TOML file of a set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.database import Database
from app.core.messages import Languages
from app.engineering.sets.drift import BusDrift, drift_rows
from app.engineering.sets.model import ParameterRow, ParameterSet, UnitRows, compare, differences
from app.engineering.sets.pages import unit_ranges
from app.engineering.sets.store import DocumentError, SetStore, read_document, write_document
from app.line.live.sources import Drifted
from app.people.audit.log import EventLog
from bus.catalogue.parameters import PARAMETERS
from bus.contract import ParameterValue
from bus.messages import Message, number
from tests.app.played_commands import a_bus
from tests.app.screens import translator


def unit(values: dict[int, int | None]) -> UnitRows:
    return UnitRows(1, "Nip", {number: ParameterRow(number, raw) for number, raw in values.items()})


def test_all_forty_rows_are_there_and_unread_ones_are_marked() -> None:
    compared = compare(unit({6: 50}), unit({}))
    assert [row.number for row in compared] == list(PARAMETERS)
    assert {row.kind for row in compared} == {"unknown"}
    assert next(row for row in compared if row.number == 6).right == Message("value_not_known")


def test_a_ramp_explains_what_the_machine_will_do() -> None:
    (row,) = differences(unit({6: 50}), unit({6: 30}))
    assert row.meaning is not None
    assert row.meaning.code == "differs_acceleration"
    assert str(row.meaning) == "accelerates in 3.0 s instead of 5.0 s"
    assert Languages()["de"].t(row.meaning) == "fährt in 3,0 s statt 5,0 s hoch"


def test_each_side_shows_speeds_with_its_decimals() -> None:
    row = next(row for row in differences(unit({3: 1, 9: 1000}), unit({3: 2, 9: 2000})) if row.number == 9)
    assert (row.left, row.right) == (number("100.0"), number("20.00"))


def test_tolerance_in_raw_counts() -> None:
    assert differences(unit({9: 1000}), unit({9: 1002}), tolerance=2) == []
    assert len(differences(unit({9: 1000}), unit({9: 1003}), tolerance=2)) == 1


def test_the_password_is_compared_but_never_shown() -> None:
    (row,) = differences(unit({21: 4711}), unit({21: 815}))
    assert "4711" not in f"{row.left}{row.right}{row.meaning}"
    assert "815" not in f"{row.left}{row.right}{row.meaning}"


def test_a_parameter_that_only_one_of_them_has_is_a_difference() -> None:
    lacking = UnitRows(1, "Nip", {40: ParameterRow(40, None, available=False)})
    (row,) = differences(unit({40: 1}), lacking)
    assert (row.kind, row.right) == ("unavailable", Message("value_not_in_unit"))
    assert differences(lacking, lacking) == []


def test_a_changed_setpoint_is_no_drift() -> None:
    assert [
        row.number for row in drift_rows(unit({20: 100, 37: 9000, 6: 50}), unit({20: 200, 37: 9500, 6: 60}))
    ] == [6]


GOLDEN_READ, NOW = 1000.0, 51_600.0
"""``NOW`` is 1970-01-01 14:20 UTC."""


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


async def test_drift_names_the_command_that_caused_it_and_counts_changes_at_the_keypad(scene: Scene) -> None:
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
    assert {number: str(value) for number, value in scene.drift.golden_values(1).items()} == {
        6: "0.0",
        7: "0.0",
        12: "0",
    }
    assert (
        await scene.text()
        == "3 values differ from the golden set: 1 changed by anna 14:20, 2 changed at the keypad"
    )
    scene.reads(12, 0)
    assert await scene.text() == "2 values differ from the golden set, changed at the keypad"
    assert 1 in scene.notified


async def test_a_change_at_the_keypad_after_a_command_is_the_cause(scene: Scene) -> None:
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


@pytest.mark.parametrize("outcome", ["refused", "not_sent"])
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


async def test_a_command_for_another_parameter_or_before_the_golden_set_is_no_cause(scene: Scene) -> None:
    await scene.sent("anna", 12, 21)
    scene.now = GOLDEN_READ - 1
    await scene.sent("anna", 1, 21)
    scene.reads(1, 21)
    assert (
        await scene.text()
        == "Maximum Motor Speed (parameter 1) differs from the golden set, changed at the keypad"
    )


async def test_the_last_write_of_the_operator_password_is_named_unseen(scene: Scene) -> None:
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
async def test_an_event_of_a_former_version_is_known_by_its_values(
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


async def test_after_a_restart_no_unit_equals_its_golden_set_before_it_was_read(scene: Scene) -> None:
    assert scene.drift.is_drifted(1) is None
    scene.reads(12, 21)
    assert scene.drift.is_drifted(1) is True
    for other in PARAMETERS.keys() - {20, 37}:
        scene.reads(other, 0)
    assert scene.drift.is_drifted(1) is False, "setpoints do not count"
    assert scene.drift.is_drifted(2) is False


async def test_the_list_on_the_units_page_has_another_key_when_its_text_changes(scene: Scene) -> None:
    keys = [scene.key()]
    for changed, raw in ((7, 0), (7, 61), (7, 62), (12, 5)):
        scene.reads(changed, raw)
        keys.append(scene.key())
    await scene.sent("erik", 12, 5)
    await scene.text()
    keys.append(scene.key())
    assert len(set(keys)) == len(keys)
    scene.reads(12, 5)
    await scene.text()
    assert scene.key() == keys[-1]
    assert scene.drift.summary(2, translator(), NOW) == Drifted()


NAMES = {1: "Unwind", 2: "Infeed nip", 4: "Dryer 1", 5: "Dryer 2", 6: "Dryer 3", 7: "Dryer 9", 9: "Rewind"}


@pytest.mark.parametrize(
    ("units", "text"),
    [
        ((), []),
        ((1, 2), ["1-2 Unwind - Infeed nip"]),
        ((6, 4, 5), ["4-6 Dryer 1-3"]),
        ((1, 2, 4, 5, 9), ["1-2 Unwind - Infeed nip", "4-5 Dryer 1-2", "9 Rewind"]),
        ((9, 200), ["9 Rewind", "200"]),
        (range(1, 10), ["1-9 Unwind - Rewind"]),
    ],
)
def test_neighbors_are_a_range(units: tuple[int, ...], text: list[str]) -> None:
    assert [each.replace("\N{EN DASH}", "-") for each in unit_ranges(units, NAMES)] == text


SECRET = 21


def a_set(values: dict[int, int], name: str = "Nip", comment: str = "") -> ParameterSet:
    rows = {number: ParameterRow(number, raw, True, 1_700_000_000.0) for number, raw in values.items()}
    return ParameterSet(
        "dry-end", 1_700_000_000.0, "anna", "by hand", (UnitRows(3, name, rows),), comment=comment
    )


raws = st.fixed_dictionaries(
    {number: st.integers(row.minimum, row.maximum) for number, row in PARAMETERS.items()}
)
words = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)


@given(values=raws, name=words, comment=words)
def test_a_written_document_is_read_again(values: dict[int, int], name: str, comment: str) -> None:
    read = read_document(write_document(a_set(values, name, comment), with_secrets=True))
    (unit,) = read.units
    assert {number: row.raw for number, row in unit.rows.items()} == values
    assert (unit.unit, unit.name, read.comment, read.bus) == (3, name, comment, "dry-end")


@given(values=raws)
def test_the_password_is_masked_unless_requested(values: dict[int, int]) -> None:
    values[SECRET] = 86420
    text = write_document(a_set(values))
    assert "86420" not in [
        word for line in text.splitlines() if line.startswith("21 ") for word in line.split()
    ]
    assert "masked = true" in text
    assert read_document(text).units[0].raw(SECRET) is None
    assert read_document(write_document(a_set(values), with_secrets=True)).units[0].raw(SECRET) == 86420


def test_one_line_a_parameter_in_its_unit() -> None:
    text = write_document(a_set({3: 1, 6: 50}))
    assert '6 = { name = "Acceleration Ramp Rate", raw = 50, value = "5.0 s" }' in text.splitlines()


def test_a_parameter_that_the_unit_lacks_stays_lacking() -> None:
    rows = {40: ParameterRow(40, None, available=False)}
    text = write_document(ParameterSet("b", 1.0, "anna", "by hand", (UnitRows(1, "A", rows),)))
    assert read_document(text).units[0].rows[40].available is False


GOOD = write_document(a_set({6: 50}))


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "not a parameter set"),
        (GOOD[: len(GOOD) - 20], "cut off"),
        (GOOD.replace("version = 1", "version = 2"), "newer version of Lineside"),
        (GOOD.replace("raw = 50", "raw = 10000"), "outside 0 to 9999"),
        (GOOD.replace("raw = 50", 'raw = "fifty"'), "raw"),
        (GOOD.replace("\n6 = ", "\n41 = "), "no parameter '41'"),
        (GOOD.replace("id = 3", "id = 300"), "id"),
        (GOOD.replace("[[unit]]", "[[drive]]").replace("[unit.", "[drive."), "unit"),
        (GOOD + GOOD[GOOD.index("[[unit]]") :], "occurs twice"),
        ('format = "something else"\n', "not a parameter set"),
        (GOOD.replace("\n6 = ", "\n06 = "), "no parameter '06'"),
        (GOOD + "6 = { raw = 51 }\n", "not readable as TOML: .*overwrite"),
        (GOOD + "x = " + "[" * 100_000, "nested too deeply"),
        (GOOD.replace("raw = 50", "raw = " + "9" * 5000), "not readable as TOML"),
        (GOOD.replace("taken_at = ", "taken_at = 0001-01-01T00:00:00 # "), "not a time of reading"),
        (GOOD + "#" * 2_000_000, "too long"),
        (GOOD.replace("raw = 50", "raw = \0 50"), "not readable as TOML"),
    ],
)
def test_nonsense_is_refused_in_words(text: str, error: str) -> None:
    with pytest.raises(DocumentError, match=error) as refused:
        read_document(text, "unit3.toml")
    assert "unit3.toml" in str(refused.value)
