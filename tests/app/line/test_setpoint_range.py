"""Every path to a setpoint and every label uses one range, which is read first where it is not known."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from app.core.web.access import Role
from app.engineering.recipes.book import RecipeBook
from app.line.commands.limits import NO_LIMITS, Limits
from app.line.commands.safeguards import Safeguards
from app.line.live.bus_live import LiveState
from bus.contract import Command, ParameterValue, ReadParameters, SetLine, SetSpeed, Update
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import PlayedWorker, result_of, snapshot, unit_state
from tests.app.played_commands import ANNA, responding
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
    response = await browser.post("/units/dry-end/1/limits", data={"highest": "10000.0"})
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
        ({8: 0, 2: None}, 99999, None, False),
        ({8: 0, 2: 0}, 99999, None, False),
        ({8: 0, 2: 0}, 100000, 99999, True),
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
