"""The range of a setpoint and the scale a value was shown with, in labels, reviews and checks."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.web.access import Role
from app.core.web.formats import UNKNOWN
from app.engineering.recipes.book import RecipeBook
from app.errors import Problem
from app.line.alarms.own_condition import known_decimals
from app.line.commands.limits import NO_LIMITS, Limits
from app.line.commands.review import change_of
from app.line.commands.safeguards import Safeguards
from app.line.commands.values import parse_scale, raw_of_percent, scale_text, scales_of
from app.line.live.bus_live import BusLive, LiveState, staged_units
from app.line.live.fields import unit_fields
from bus.contract import (
    Command,
    ParameterValue,
    ReadParameters,
    SetLine,
    SetSpeed,
    Staged,
    UnitLink,
    Update,
    WriteAnalogOutput,
    WriteParameter,
)
from bus.errors import CallerError
from bus.instants import UnixTime
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import PlayedWorker, result_of, snapshot, unit_state
from tests.app.played_commands import ANNA, responding
from tests.app.screens import line, reading, translator
from tests.for_each import for_each

TO = "\N{EN DASH}"

# --- every path ---------------------------------------------------------------------------------


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    """Two units, 0 to 2000.0 (#2, one decimal), at 100.0."""
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState])
        yield house


@for_each(
    ("method", "path", "body"),
    [
        ("POST", "/units/1/speed", {"raw": 20001}),
        ("POST", "/units/1/speed", {"value": "2000.1", "execute": False}),
        ("POST", "/speeds", {"setpoints": {"2": {"raw": 5}, "1": {"value": "2000.1"}}}),
        ("PUT", "/units/1/parameters/20", {"raw": 20001}),
        ("PUT", "/units/1/parameters/20", {"value": "2000.1"}),
    ],
)
async def test_a_program_is_refused_above_the_maximum_with_the_nearest(
    house: House, method: str, path: str, body: Any
) -> None:
    program = await house.program(Role.ENGINEER)
    response = await program.request(method, f"/api/v1/buses/dry-end{path}", json=body)
    result = response.json()
    assert (response.status_code, result["code"], result["nearest"]) == (422, "invalid", 20000)
    assert "2000.1 is outside 0.0 to 2000.0" in result["detail"]


@for_each(
    ("path", "form"),
    [
        ("/units/dry-end/1/review", {"value": "2000.1"}),
        ("/units/dry-end/1/review", {"value": "2000.1", "how": "stage"}),
        ("/units/dry-end/1/nudge", {"step": "19001", "id": "c" * 32, "scale": "-"}),
        ("/setpoints/review", {"bus": "dry-end", "new-2": "5.0", "new-1": "2000.1"}),
        ("/units/dry-end/1/parameters/20/review", {"value": "2000.1"}),
    ],
)
@for_each("language", ["en", "de"])
async def test_a_person_gets_no_review_above_the_maximum(
    house: House, path: str, form: dict[str, str], language: str
) -> None:
    browser = await house.signed_in(Role.ENGINEER)
    response = await browser.post(path, data=form, headers={"Accept-Language": language})
    assert response.status_code == 422
    assert "data-review" not in response.text
    assert ("2000,0" if language == "de" else "2000.0") in response.text
    assert language == "en" or "nearest" not in response.text


async def test_what_was_reviewed_below_a_maximum_that_has_sunk_since_is_refused(house: House) -> None:
    house.services[LiveState].buses["dry-end"].apply([ParameterValue(unit=1, number=2, at=2.0, raw=900)])
    browser = await house.signed_in(Role.OPERATOR)
    recipe = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 1000})
    reviewed = {"id": "c" * 32, "reviewed_at": f"{time.time()}", "raw-1": "1000", "was-1": "1000"}
    reviewed |= {"scale": "-", "scale-1": "-"}
    for path, form in (
        ("/units/dry-end/1/speed", {"raw": "1000", "was": "1000", "how": "now"}),
        ("/setpoints", {"bus": "dry-end"}),
        (f"/recipes/{recipe.id}/load", {}),
    ):
        response = await browser.post(path, data=reviewed | form)
        assert "100.0 is outside 0.0 to 90.0" in response.text, path
    assert "100.0 is outside 0.0 to 90.0" in (await browser.get(f"/recipes/{recipe.id}")).text


async def test_labels_agree_with_the_checks(house: House) -> None:
    browser = await house.signed_in(Role.ENGINEER)
    bus = "/api/v1/buses/dry-end/units/1"
    for highest, label in ((None, "2000.0"), (25000, "2500.0"), (1500, "150.0")):
        await house.services.buses["dry-end"][Safeguards].set_limits(ANNA, 1, Limits(highest=highest))
        assert f"0.0 to {label}" in (await browser.get("/units/dry-end/1")).text
        assert f"0.0 to {label}" in (await browser.get("/setpoints")).text
        review = await browser.post("/units/dry-end/1/review", data={"value": label})
        assert f"0.0 to {label}" in review.text
        shown = (await browser.get(f"{bus}/setpoint-range")).json()
        raw = highest or 20000
        assert (shown["highest_raw"], shown["highest"], shown["lowest_raw"]) == (raw, label, 0)
        assert f"0{TO}{raw} raw" in (await browser.get("/units/dry-end/1/parameters")).text
        review = await browser.post("/units/dry-end/1/parameters/20/review", data={"value": label})
        assert f"0{TO}{raw}" in review.text
        above = await browser.post(f"{bus}/speed", json={"raw": raw + 1})
        assert above.json()["nearest"] == raw


async def test_an_engineer_s_limit_is_what_the_protocol_can_carry_at_most(house: House) -> None:
    browser = await house.signed_in(Role.ENGINEER)
    limits = {"lowest": "", "highest": "10000.0", "largest_step": "", "per_minute": ""}
    response = await browser.post("/units/dry-end/1/limits", data=limits)
    assert "9999.9" in response.text
    assert house.services.buses["dry-end"][Safeguards].limits(1) == NO_LIMITS


# --- what was never read is read first --------------------------------------------------------------


def unit_with_parameters(values: dict[int, int | None]) -> Any:
    """Return a worker's play: reads return these values, every write is verified."""

    async def play(command: Command) -> Sequence[Update]:
        if not isinstance(command.action, ReadParameters):
            return [result_of(command, "verified")]
        read_values = [
            ParameterValue(
                command.action.unit, number, time.time(), values[number], available=values[number] is not None
            )
            for number in command.action.numbers
            if number in values
        ]
        outcome = "verified" if len(read_values) == len(command.action.numbers) else "unverified"
        return [*read_values, result_of(command, outcome, values=read_values)]

    return play


async def unread(site: House, values: dict[int, int | None]) -> PlayedWorker:
    """Return a worker whose unit 1 has no parameter read yet."""
    states = [unit_state(1, {}), unit_state(2), unit_state(16)]
    worker = await site.worker(state=snapshot(units=states))
    worker.play = unit_with_parameters(values)
    return worker


@pytest.mark.parametrize(
    ("values", "raw", "nearest", "many"),
    [
        ({8: 0, 2: 20000}, 20001, 20000, False),
        ({8: 0, 2: 20000}, 20000, None, True),
        ({8: 0, 2: 0}, 99999, None, False),
        ({8: 1, 2: 20000, 31: 15000, 38: 5000}, 15001, 15000, False),
        ({8: 1, 2: 20000, 31: 15000, 38: 5000}, 4999, 5000, True),
    ],
)
async def test_it_is_read_within_the_time_of_the_command(
    site: House, values: dict[int, int | None], raw: int, nearest: int | None, many: bool
) -> None:
    worker = await unread(site, values)
    path, body = ("/speeds", {"setpoints": {"1": {"raw": raw}}}) if many else ("/units/1/speed", {"raw": raw})
    response = await site.request("POST", path, body)
    assert response.status_code == (200 if nearest is None else 422), response.text
    assert response.json().get("nearest") == nearest
    written = [
        command.action for command in worker.commands if not isinstance(command.action, ReadParameters)
    ]
    expected = [SetLine(setpoints={1: raw}) if many else SetSpeed(unit=1, raw=raw)]
    assert written == ([] if nearest else expected)
    assert len({round(command.deadline, 1) for command in worker.commands}) <= 2


async def test_what_cannot_be_read_is_not_taken_for_unlimited(site: House) -> None:
    worker = await unread(site, {8: 0})
    for path, body in (
        ("/units/1/speed", {"raw": 5}),
        ("/speeds", {"setpoints": {"1": {"raw": 5}, "2": {"raw": 5}}}),
        ("/units/1/parameters/20", {"raw": 5}),
    ):
        response = await site.request("PUT" if "parameters" in path else "POST", path, body)
        result = response.json()
        assert (response.status_code, result["code"], result["outcome"]) == (504, "unverified", "unverified")
        assert "could not be read from unit 1" in result["detail"]
        assert {unit["outcome"] for unit in result["units"].values()} <= {"not_sent"}
        assert set(result["units"]) == ({"1", "2"} if path == "/speeds" else set())
    assert all(isinstance(command.action, ReadParameters) for command in worker.commands)


async def test_zero_waits_for_nothing_to_be_read(site: House) -> None:
    worker = await unread(site, {})
    assert (await site.request("POST", "/units/1/speed", {"raw": 0})).status_code == 200
    assert [command.action for command in worker.commands] == [SetSpeed(unit=1, raw=0)]


async def test_each_that_was_never_read_is_read_once(site: House) -> None:
    states = [unit_state(number, {}) for number in (1, 2, 16)]
    worker = await site.worker(state=snapshot(units=states))
    worker.play = unit_with_parameters({8: 0, 2: 20000})
    body = {"setpoints": {number: {"raw": 100} for number in ("1", "2", "16")}}
    assert (await site.request("POST", "/speeds", body)).status_code == 200
    assert worker.commands[-1].action == SetLine({1: 100, 2: 100, 16: 100})
    assert len(worker.commands) == 4


SCALES = st.dictionaries(st.integers(1, 40), st.none() | st.integers(0, 0xFFFF_FFFF), max_size=6)


@given(SCALES)
def test_a_form_holds_what_the_review_was_made_with(scale: dict[int, int | None]) -> None:
    assert parse_scale(scale_text(scale)) == scale


@pytest.mark.parametrize(
    "text",
    [None, "", "3", "3:", "3:x", "3:1,", ",3:1", "41:1", "0:1", "3:99999999999", "3:-1", "3 :1", "³:1"],
)
def test_what_no_review_holds_is_refused(text: str | None) -> None:
    with pytest.raises(Problem, match="differs from the review"):
        parse_scale(text)


@pytest.fixture
def bus() -> BusLive:
    bus = line().buses["dry"]
    bus.apply([reading(), *(read(number, raw) for number, raw in {2: 20000, 3: 1, 8: 0, 6: 50}.items())])
    return bus


def read(number: int, raw: int | None, at: float = 100.0) -> ParameterValue:
    return ParameterValue(unit=1, number=number, at=UnixTime(at), raw=raw)


def test_what_converts_and_bounds_each_kind_of_value(bus: BusLive) -> None:
    assert scales_of(SetSpeed(1, 1200), bus) == {1: {2: 20000, 8: 0, 3: 1}}
    assert scales_of(SetLine({1: 1200}), bus) == {1: {2: 20000, 8: 0, 3: 1}}
    assert scales_of(WriteParameter(1, 12, 5), bus) == {1: {3: 1}}
    assert scales_of(WriteParameter(1, 9, 5), bus) == {1: {8: 0, 3: 1}}
    assert scales_of(WriteParameter(1, 6, 50), bus) == {1: {}}
    assert scales_of(SetSpeed(1, 0), bus) == {1: {}}, "nothing keeps a line from being set to zero"
    bus.apply([read(28, 2), read(29, 100), read(30, 2000)])
    assert scales_of(WriteAnalogOutput(1, 350), bus) == {1: {28: 2, 29: 100, 30: 2000}}
    bus.apply([read(8, 1), read(31, 20000), read(38, 5000)])
    assert scales_of(SetSpeed(1, 12000), bus) == {1: {38: 5000, 31: 20000, 8: 1}}


def state_text(bus: BusLive) -> str:
    return str(unit_fields(bus, bus.units[1], "online", translator())["state_text"])


def test_a_speed_is_not_shown_before_its_decimals_are_read(bus: BusLive) -> None:
    unit = bus.units[1]
    bus.apply([reading(1, 1.0)])
    assert unit_fields(bus, unit, "online", translator())["actual"] == "120.0"
    unit.parameters.clear()
    fields = unit_fields(bus, unit, "online", translator())
    assert [fields[name] for name in ("actual", "commanded", "deviation")] == [UNKNOWN] * 3
    assert "scale is being read" in fields["state_text"]


def test_one_parameter_changed_at_the_keypad_makes_the_scale_old_until_it_is_read_again(bus: BusLive) -> None:
    unit = bus.units[1]
    assert not unit.scale_is_old
    bus.apply([read(6, 60, at=101.0)])
    assert unit.scale_is_old
    assert "scale is being read again" in state_text(bus)
    assert known_decimals(bus, unit) is None, "an alarm of the site is judged in no scale that may be another"
    bus.apply([read(number, unit.parameters[number].raw or 0, at=102.0) for number in list(unit.parameters)])
    assert not unit.scale_is_old
    assert "scale" not in state_text(bus)
    assert known_decimals(bus, unit) == 1


def test_a_reading_whose_decimals_were_never_read_says_so() -> None:
    bus = line().buses["dry"]
    bus.units[1].parameters.clear()
    assert "scale is being read" in state_text(bus)
    bus.apply([read(3, None)])
    assert "scale" not in state_text(bus), "a unit may lack them"


def test_a_setpoint_that_a_host_has_changed_is_no_change_at_the_keypad(bus: BusLive) -> None:
    bus.apply([read(20, 500), read(20, 600, at=101.0)])
    assert not bus.units[1].scale_is_old


def test_an_absence_makes_the_scale_old_and_a_staged_speed_unknown(bus: BusLive) -> None:
    unit = bus.units[1]
    bus.apply([Staged(1, UnixTime(100.0), 700)])
    assert unit_fields(bus, unit, "online", translator())["staged"] == "70.0"
    assert [each[1:] for each in staged_units([bus], UnixTime(100.0))] == [([unit.settings.name], [], [], [])]
    bus.apply([UnitLink(1, UnixTime(101.0), "offline"), Staged(1, UnixTime(101.0), None, unknown=True)])
    assert unit_fields(bus, unit, "offline", translator())["staged"] == "?"
    lost = [([], [unit.settings.name], [unit.settings.name], [])]
    assert [each[1:] for each in staged_units([bus], UnixTime(101.0))] == lost
    assert not unit.scale_is_old
    bus.apply([UnitLink(1, UnixTime(102.0), "online")])
    assert unit.scale_is_old
    assert unit.staged_unknown
    bus.apply([Staged(1, UnixTime(103.0), 800)])
    assert (unit.staged, unit.staged_unknown) == (800, False)


@pytest.mark.parametrize(
    ("text", "raw"),
    [
        ("105 %", 1260),
        ("105%", 1260),
        ("+5 %", 1260),
        ("-5%", 1140),
        ("97,5 %", 1170),
        ("0.04 %", 0),
        ("0,05%", 1),
    ],
)
def test_percent_are_of_the_unit_s_own_setpoint(text: str, raw: int) -> None:
    assert raw_of_percent(text, 1200) == raw


@pytest.mark.parametrize("text", ["%", "x %", "-101 %", "5 % 5 %", "99999 %", "1.2345 %", "--5 %"])
def test_what_is_no_percentage_is_refused_with_what_would_be_right(text: str) -> None:
    with pytest.raises(CallerError, match="105 % is five percent more"):
        raw_of_percent(text, 1200)


def test_a_percentage_of_a_setpoint_that_is_not_known_is_refused() -> None:
    with pytest.raises(CallerError, match="present setpoint is not known"):
        raw_of_percent("105 %", None)


def test_the_review_of_a_typed_setpoint_keeps_the_scale_that_it_was_converted_with(bus: BusLive) -> None:
    """Also where the unit was found with another one until the review is there."""
    unit = bus.units[1]
    typed_with = scales_of(SetSpeed(1, 1000), bus)[1]
    bus.apply([read(3, 0, at=101.0)])
    change = change_of(bus, unit, 1000, NO_LIMITS, UnixTime(101.0), typed_with=typed_with)
    assert parse_scale(change.scale) == {2: 20000, 8: 0, 3: 1}
    assert parse_scale(change_of(bus, unit, 0, NO_LIMITS, UnixTime(101.0), typed_with={}).scale) == {}
