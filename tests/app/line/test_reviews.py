"""What the reviews of the pages show before anything is sent: units at risk, units left out, and the units of
every number; in English and German.
"""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from app.core.web.access import Role
from app.engineering.recipes.book import RecipeBook
from app.line.commands.limits import Limits
from app.line.commands.safeguards import Safeguards
from app.line.live.bus_live import LiveState
from bus.contract import BusLink, ParameterValue, Reading, Staged, UnitLink
from tests.app.complete_app import House, complete_app
from tests.app.played_commands import ANNA, HEALTHY, REMOTE, RUN, fresh, responding
from tests.app.played_line import played_line
from tests.for_each import for_each

ACCELERATION = "/units/dry-end/1/parameters/6"
NOTICE = re.compile(r'data-remark="(\w+)">.*?<p><b>([^<]*)</b>([^<]*)</p>', re.S)


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    """Two units that run in REMOTE at 100.0 of 2000.0; only the first has a label for its unit, m/min."""
    async with complete_app(tmp_path) as house:
        responding(house.services[LiveState], run=True)
        await house.signed_in(Role.OPERATOR)
        yield house


def report(
    house: House, unit: int, *, inputs: int = HEALTHY | RUN, outputs: int = REMOTE, **more: float
) -> None:
    """A unit responds like this."""
    at = time.time() - more["age"] if more else fresh()
    house.services[LiveState].buses["dry-end"].apply([Reading(unit, at, 1000, 1000, 0, outputs, inputs)])


def report_parameter(house: House, unit: int, number: int, raw: int | None) -> None:
    """A unit has this parameter."""
    value = ParameterValue(unit=unit, number=number, at=1.0, raw=raw, available=raw is not None)
    house.services[LiveState].buses["dry-end"].apply([value])


def remarks(response: httpx.Response) -> list[tuple[str, str]]:
    """Return (code, names) of the remarks, in order."""
    assert response.status_code == 200, response.text
    return [(code, names) for code, names, _ in NOTICE.findall(response.text)]


def operator(house: House) -> httpx.AsyncClient:
    """Who reviews."""
    return house.clients[0]


async def single(house: House, value: str = "150.0", **form: str) -> httpx.Response:
    browser = operator(house)
    return await browser.post("/units/dry-end/1/review", data={"value": value, **form})


async def group(house: House, **setpoints: str) -> httpx.Response:
    browser = operator(house)
    return await browser.post("/setpoints/review", data={"bus": "dry-end", **setpoints})


async def recipe(house: House, units: dict[int, int]) -> httpx.Response:
    browser = operator(house)
    saved = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", units)
    return await browser.get(f"/recipes/{saved.id}/review")


async def zero(house: House) -> httpx.Response:
    return await operator(house).get("/line/zero")


async def test_without_a_risk_there_is_no_remark(house: House) -> None:
    assert remarks(await single(house)) == []


@for_each("way", ["single", "group", "recipe", "zero"])
async def test_a_unit_at_risk_is_named_by_every_review(house: House, way: str) -> None:
    report(house, 1, inputs=0)
    for ramp in (6, 7):
        report_parameter(house, 1, ramp, 0)
    match way:
        case "single":
            response = await single(house, "50.0")
        case "group":
            response = await group(house, **{"new-1": "50.0", "new-2": "150.0"})
        case "recipe":
            response = await recipe(house, {1: 500, 2: 1500})
        case _:
            response = await zero(house)
    expected = [("risk_estop_active", "Unwind"), ("risk_run_off", "Unwind"), ("risk_no_ramp", "Unwind")]
    assert remarks(response) == expected
    assert "data-review-act" in response.text
    # The browser ends it once these inputs change; a change to zero stays open.
    assert re.findall(r'data-signals="(\d+)"', response.text)[:1] == ([] if way == "zero" else ["01"])


async def test_a_change_of_several_names_units_left_out_and_why(house: House) -> None:
    report(house, 2, outputs=0)
    assert remarks(await group(house, **{"new-1": "50.0"})) == [("obstacle_not_in_remote", "Nip")]


async def test_a_recipe_and_zero_name_units_left_out_too(house: House) -> None:
    report(house, 2, outputs=0)
    assert remarks(await recipe(house, {1: 500})) == [("obstacle_not_in_remote", "Nip")]
    await house.services.buses["dry-end"][Safeguards].block(ANNA, 2, "belt off")
    response = await zero(house)
    assert remarks(response) == [("left_running", "Nip")]
    assert "belt off" in response.text


@pytest.fixture
async def two_lines(house: House, tmp_path: Path) -> AsyncIterator[House]:
    """As ``house``, with a second line, whose unit responds too."""
    buses = (
        'name = "dry-end"\nport = "/dev/a"\nunit = [{id = 1, name = "Unwind"}, {id = 2, name = "Nip"}]',
        ('name = "wet-end"\nport = "/dev/b"\nunit = [{id = 1, name = "Forming"}]'),
    )
    config = tmp_path / "lineside.toml"
    config.write_text("".join(f"[[bus]]\n{bus}\n" for bus in buses), encoding="utf-8")
    async with complete_app(tmp_path / "two", config=config) as house:
        responding(house.services[LiveState], run=True)
        wet = house.services[LiveState].buses["wet-end"]
        wet.apply([BusLink(at=1.0, link="open"), UnitLink(unit=1, at=1.0, link="online")])
        wet.apply([Reading(1, fresh(), 1000, 1000, 0, REMOTE, HEALTHY | RUN)])
        await house.signed_in(Role.OPERATOR)
        yield house


async def test_each_line_is_set_to_zero_by_choice(two_lines: House) -> None:
    browser = operator(two_lines)
    text = (await browser.get("/line/zero")).text
    assert re.findall(r'name="bus" value="([^"]*)" checked', text) == ["dry-end", "wet-end"]
    assert re.search(r"data-review-act>([^<]*)<", text)[1] == "Set 2 lines to zero"  # type: ignore[index]
    assert ": 1 unit; of 1 unit the ramp is not known yet" in text
    text = (await browser.get("/line/zero?bus=wet-end")).text
    assert re.findall(r'name="bus" value="([^"]*)"', text) == ["wet-end"]
    assert text.count("Set line wet-end to zero") == 2, "title and button"
    assert "Not part of this change: dry-end" in text
    assert (await browser.get("/line/zero?bus=gone")).status_code == 404


async def test_a_page_of_one_line_sets_that_one_to_zero(two_lines: House) -> None:
    browser = operator(two_lines)
    for path, review in (
        ("/units/wet-end/1", "/line/zero?bus=wet-end"),
        ("/bus/wet-end", "/line/zero?bus=wet-end"),
        ("/?bus=wet-end", "/line/zero"),
        ("/units/gone/1", "/line/zero"),
    ):
        text = (await browser.get(path, headers={"Accept": "text/html"})).text
        assert f'hx-get="{review}"' in text, path


async def test_a_line_that_is_not_ticked_gets_nothing(two_lines: House) -> None:
    form = {"id": "a" * 32, "reviewed_at": str(time.time())}
    browser = operator(two_lines)
    text = (await browser.post("/line/zero", data={**form, "bus": "wet-end"})).text
    assert "Forming" in text
    assert "Unwind" not in text
    assert (await browser.post("/line/zero", data=form)).status_code == 422
    assert (await browser.post("/line/zero", data={**form, "bus": "gone"})).status_code == 404


async def test_units_not_part_of_it_are_named_without_alarm(house: House) -> None:
    response = await group(house, **{"new-1": "50.0"})
    assert remarks(response) == []
    assert "Not part of this change: Nip" in response.text


async def test_a_unit_of_the_change_that_cannot_take_it_is_an_obstacle(house: House) -> None:
    report(house, 2, age=60)
    response = await group(house, **{"new-1": "50.0", "new-2": "50.0"})
    assert remarks(response) == [("obstacle_offline", "Nip")]
    assert "All units change or none" in response.text


@for_each("link", ["local", "offline"])
async def test_a_unit_outside_a_change_that_could_move_with_it_is_named_before_it(
    house: House, link: str
) -> None:
    report(house, 2, outputs=0) if link == "local" else report(house, 2, age=60)
    house.services[LiveState].buses["dry-end"].apply([Staged(2, time.time(), None, unknown=True)])
    response = await group(house, **{"new-1": "50.0"})
    advice = "Set Nip to REMOTE at its keypad" if link == "local" else "Check its power"
    assert response.status_code == 422
    assert re.search(f"Nip .* it would move too: no unit was changed. {advice}", response.text)
    assert (await single(house)).status_code == 200, "the same by itself"


@pytest.mark.parametrize("what", ["outputs/3", "analog-output/review"])
async def test_an_output_that_the_unit_cannot_switch_now_is_an_obstacle(house: House, what: str) -> None:
    browser = await house.signed_in(Role.ENGINEER)

    async def review() -> list[tuple[str, str]]:
        path = f"/units/dry-end/1/{what}"
        sending = browser.get(path) if "outputs" in what else browser.post(path, data={"value": "7"})
        return remarks(await sending)

    assert await review() == []
    report(house, 1, outputs=0)
    assert await review() == [("obstacle_not_in_remote", "Unwind")]
    report(house, 1, age=60)
    assert await review() == [("obstacle_offline", "Unwind")]


async def test_an_unknown_ramp_is_reported(house: House) -> None:
    report_parameter(house, 1, 6, None)
    assert remarks(await single(house)) == [("risk_ramp_unknown", "Unwind")]


async def test_an_old_value_is_shown_with_its_age(house: House) -> None:
    report(house, 1, age=4)
    response = await single(house)
    assert remarks(response) == [("risk_stale", "Unwind")]
    assert re.search(r"last response is \d s old", response.text)


async def test_an_engineers_limit_above_the_maximum_is_reported(house: House) -> None:
    await house.services.buses["dry-end"][Safeguards].set_limits(ANNA, 1, Limits(highest=25000))
    assert remarks(await single(house, "2100.0")) == [("risk_above_display", "Unwind")]
    assert remarks(await single(house, "2000.0")) == []


async def test_executing_leaves_a_unit_that_cannot_where_it_is(house: House) -> None:
    """It is named, and is in no row, no count and no form; back in REMOTE, it would execute: a new review."""
    live = house.services[LiveState].buses["dry-end"]
    live.apply([Staged(unit, 1.0, 1500) for unit in (1, 2)])
    report(house, 2, outputs=0)
    review = await operator(house).get("/bus/dry-end/staged/review")
    assert remarks(review) == [("obstacle_not_in_remote", live.units[2].settings.name)]
    strip = await operator(house).get("/tray/strip")
    assert all("Execute 1 staged" in part.text for part in (review, strip))
    form = dict(re.findall(r'type="hidden" name="([\w-]+)"\s+value="([^"]*)"', review.text))
    assert (form["raw-1"], "raw-2" in form) == ("1500", False)
    report(house, 2)
    refused = await operator(house).post("/bus/dry-end/staged/execute", data=form)
    assert (refused.status_code, "nothing was sent" in refused.text) == (409, True)
    for unit in (1, 2):
        report(house, unit, outputs=0)
    assert "data-review-act" not in (await operator(house).get("/bus/dry-end/staged/review")).text
    strip = await operator(house).get("/tray/strip")
    assert ("<button" in strip.text, "choose REMOTE at the keypad" in strip.text) == (False, True)


@for_each("inputs", [RUN, HEALTHY])
async def test_a_nudge_that_takes_no_effect_now_is_reviewed(house: House, inputs: int) -> None:
    report(house, 1, inputs=inputs)
    form = {"step": "1", "id": "n" * 32, "scale": "-"}
    response = await operator(house).post("/units/dry-end/1/nudge", data=form)
    assert remarks(response)[0][1] == "Unwind"
    assert "data-review-act" in response.text


async def test_a_staged_value_has_no_risk_yet(house: House) -> None:
    report(house, 1, inputs=0)
    assert remarks(await single(house, how="stage")) == []


async def test_every_number_has_its_unit(house: House) -> None:
    for response in (
        await single(house),
        await group(house, **{"new-1": "150.0"}),
        await recipe(house, {1: 1500}),
    ):
        for number in ("100.0", "150.0"):
            found = re.search(rf"{number}(</?b>|<small>|<span>|\s)*m/min", response.text)
            assert found, (number, response.text)
    assert "0.0 to 2000.0 m/min" in (await single(house)).text


async def test_a_ramp_of_nothing_is_warned_of_where_it_is_written(house: House) -> None:
    browser = await house.signed_in(Role.ENGINEER)
    report_parameter(house, 1, 16, 1)
    response = await browser.post("/units/dry-end/1/parameters/7/review", data={"value": "0.0"})
    assert remarks(response) == [("effect_no_ramp", "Unwind")]
    assert 'data-of="dry-end/1"' in response.text, "it ends once the unit leaves REMOTE"
    assert re.search(r"0\.0 <small>s</small>", response.text)
    speed = await browser.post("/units/dry-end/1/parameters/20/review", data={"value": "50.0"})
    assert remarks(speed) == [("effect_setpoint", "Unwind")]
    assert "50.0 <small>m/min</small>" in speed.text


async def test_a_block_is_lifted_behind_a_review_of_that_block(house: House) -> None:
    lift = "/units/dry-end/1/unblock"
    guards = house.services.buses["dry-end"][Safeguards]
    await guards.block(ANNA, 1, "belt off")
    page = (await operator(house).get(lift)).text
    assert "belt off" in page
    assert ANNA.name in page
    form = dict(re.findall(r'name="(\w+)" value="([^"]*)"', page))
    await guards.block(ANNA, 1, "felt off")
    refused = await operator(house).post(lift, data=form)
    assert (refused.status_code, guards.block_of(1) is None) == (409, False)
    form = dict(re.findall(r'name="(\w+)" value="([^"]*)"', (await operator(house).get(lift)).text))
    assert (await operator(house).post(lift, data=form)).headers["HX-Redirect"] == "/units/dry-end/1"
    assert "felt off" in (await operator(house).get("/units/dry-end/1")).text


async def reviewed_write(browser: httpx.AsyncClient, value: str) -> dict[str, str]:
    """The form of a review of the acceleration of unit 1."""
    return fields_of(await browser.post(f"{ACCELERATION}/review", data={"value": value}))


def fields_of(review: httpx.Response) -> dict[str, str]:
    return dict(re.findall(r'type="hidden" name="(\w+)" value="([^"]*)"', review.text))


async def test_a_parameter_that_the_keypad_has_changed_meanwhile_is_not_overwritten(house: House) -> None:
    line, browser = await played_line(house.services), await house.signed_in(Role.ENGINEER)
    line.memory[1][6] = 33
    form = await reviewed_write(browser, "1.0")
    assert form["was"] == "33"
    line.memory[1][6] = 44
    refused = await browser.post(ACCELERATION, data=form)
    assert (refused.status_code, "it is 4.4 now; nothing was sent" in refused.text) == (409, True)
    assert re.search(r'hx-target="#parameter-6-value"[^>]*><b>4\.4</b>', refused.text), "in its row too"
    assert line.written == []


async def test_a_parameter_that_cannot_be_read_before_its_write_is_not_written(house: House) -> None:
    browser = await house.signed_in(Role.ENGINEER)
    answer = await browser.post(ACCELERATION, data=await reviewed_write(browser, "1.0"))
    assert "not sent: there is no link to the bus" in answer.text


async def test_an_undo_does_not_overwrite_what_the_keypad_has_changed(house: House) -> None:
    line, browser = await played_line(house.services), await house.signed_in(Role.ENGINEER)
    done = await browser.post(ACCELERATION, data=await reviewed_write(browser, "1.0"))
    undo = re.search(r"/bus/dry-end/undo/[\w-]+", done.text)
    assert undo, done.text
    form = fields_of(await browser.get(undo[0]))
    line.memory[1][6] = 44
    assert (await browser.post(ACCELERATION, data=form)).status_code == 409
    assert line.written == [(1, 6, 10)]


async def test_a_form_that_comes_twice_at_once_is_one_write_and_no_other_value(house: House) -> None:
    line, browser = await played_line(house.services), await house.signed_in(Role.ENGINEER)
    form = await reviewed_write(browser, "1.0")
    answers = await asyncio.gather(*(browser.post(ACCELERATION, data=form) for _ in range(2)))
    assert [each.status_code for each in answers] == [200, 200]
    assert line.written == [(1, 6, 10)]
