"""Recipes: versions, obstacles, loading, units that leave them; and changes that arrive again under their
id."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.core.database import Database
from app.core.web.access import Role
from app.engineering.recipes.book import RecipeBook, RecipeStore
from app.engineering.recipes.rules import (
    NOT_CONFIGURED,
    Recipe,
    RecipeDryRunStep,
    RecipeSetpoint,
    dry_run,
    setpoints_now,
    why_not_setpoint,
)
from app.errors import Problem
from app.line.commands.review import DrawChange
from app.line.live.bus_live import LiveState
from bus.contract import BusLink, ExecuteAll, ExecuteSpeed, ParameterValue, Reading, SetLine, Staged, UnitLink
from bus.instants import UnixTime, monotonic_now, unix_now
from bus.messages import Message, in_english
from tests.app.complete_app import House
from tests.app.fake_worker import until
from tests.app.played_commands import ANNA, HEALTHY, REMOTE, Noted, PlayedCommands, a_bus, fresh, responding
from tests.app.played_line import BUS, PlayedLine, played_line
from tests.for_each import for_each


class Scene:
    def __init__(self, folder: Path) -> None:
        self.live = a_bus()
        self.commands = PlayedCommands(self.live, {})
        self.events = Noted()
        self.database = Database(folder / "store.db")
        store = RecipeStore(self.database)
        self.book = RecipeBook(self.live, {"dry-end": self.commands}, store, self.events)  # type: ignore[arg-type]


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return Scene(tmp_path)


async def test_a_new_save_is_a_new_version_and_the_old_one_stays(scene: Scene) -> None:
    responding(scene.live)
    one = await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {1: 1200, 2: 1210})
    two = await scene.book.save(ANNA, "dry-end", "Kraft 80", "faster", {1: 1300})
    assert (one.version, two.version) == (1, 2)
    assert [recipe.version for recipe in await scene.book.store.newest()] == [2]
    assert [recipe.version for recipe in await scene.book.store.versions("dry-end", "Kraft 80")] == [2, 1]
    kept = await scene.book.store.load(one.id)
    assert kept is not None
    assert [(row.unit, row.raw, row.kind) for row in kept.setpoints] == [
        (1, 1200, "speed"),
        (2, 1210, "speed"),
    ]


async def test_a_complete_list_has_an_end(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.engineering.recipes.book.MAX_RECIPES", 2)
    responding(scene.live)
    for name in ("one", "two", "two"):
        await scene.book.save(ANNA, "dry-end", name, "", {1: 1200})
    with pytest.raises(Problem, match="2 recipes in use"):
        await scene.book.save(ANNA, "dry-end", "three", "", {1: 1200})
    await scene.book.retire(ANNA, "dry-end", "one")
    await scene.book.save(ANNA, "dry-end", "three", "", {1: 1200})


async def test_a_unit_whose_mode_was_never_read_cannot_be_in_a_recipe(scene: Scene) -> None:
    with pytest.raises(Problem, match=r"\(parameter 8\)"):
        await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {1: 1200})


async def test_the_dry_run_shows_old_new_and_the_time_of_the_ramp(scene: Scene) -> None:
    responding(scene.live, commanded=1000)
    recipe = await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {1: 11000, 2: 0})
    run = scene.book.try_out(ANNA, recipe)
    assert run.loadable
    assert [(str(step.old), step.new, step.ramp_s) for step in run.steps] == [
        ("100.0", "1100.0", 5.0),
        ("100.0", "0.0", 0.25),
    ]
    assert run.ramp_s == 5.0
    assert scene.commands.sent == []


@pytest.mark.parametrize(
    ("raw", "remote", "mode", "error"),
    [(20001, True, 0, "maximum"), (100, False, 0, "not in REMOTE"), (100, True, 1, "ratio")],
)
async def test_obstacles_are_reported_and_nothing_is_sent(
    scene: Scene, raw: int, remote: bool, mode: int, error: str
) -> None:
    responding(scene.live)
    recipe = await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {1: 100, 2: raw})
    responding(scene.live, remote=remote)
    scene.live.buses["dry-end"].apply([ParameterValue(unit=2, number=8, at=2.0, raw=mode)])
    with pytest.raises(Problem, match=error):
        await scene.book.load(ANNA, recipe, monotonic_now(), confirm=True, command_id=None)
    assert scene.commands.sent == []


async def test_a_refusal_states_once_that_nothing_was_sent(scene: Scene) -> None:
    responding(scene.live)
    recipe = await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {1: 100, 2: 95000})
    with pytest.raises(Problem) as refused:
        await scene.book.load(ANNA, recipe, monotonic_now(), confirm=True, command_id=None)
    assert str(refused.value).count("nothing was sent") == 1


async def test_loaded_as_one_change_and_what_departs_since(scene: Scene) -> None:
    responding(scene.live)
    recipe = await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {1: 1200, 2: 1210})
    await scene.book.load(ANNA, recipe, monotonic_now(), confirm=True, command_id="one")
    assert scene.commands.sent == [SetLine(setpoints={1: 1200, 2: 1210})]
    loaded = scene.book.loaded("dry-end")
    assert loaded is not None
    assert loaded.recipe.id == recipe.id
    responding(scene.live, commanded=1200)
    assert [(one.unit, one.recipe, str(one.now)) for one in scene.book.departed("dry-end")] == [
        (2, "121.0", "120.0")
    ]
    assert scene.book.loaded_words("dry-end") == ("Kraft 80", ["Nip"])


async def test_units_are_left_out_by_name_and_the_event_names_them(scene: Scene) -> None:
    responding(scene.live)
    recipe = await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {1: 1200, 2: 95000})

    async def load(*left_out: int) -> None:
        await scene.book.load(
            ANNA, recipe, monotonic_now(), confirm=True, command_id="one", left_out=left_out
        )

    for refused, left_out in (("Nip", (1,)), ("every unit", (1, 2))):
        with pytest.raises(Problem, match=refused):
            await load(*left_out)
    await load(2)
    assert scene.commands.sent == [SetLine(setpoints={1: 1200})]
    loaded = scene.events.events[-1]
    assert (loaded["kind"], in_english(loaded["message"])) == ("recipe", "left out: Nip")
    responding(scene.live, commanded=1200)
    assert scene.book.loaded_words("dry-end") == ("Kraft 80", ["Nip"])


async def test_after_a_restart_it_is_still_loaded_and_a_unit_that_is_gone_has_departed(scene: Scene) -> None:
    responding(scene.live)
    recipe = await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {1: 1200, 2: 1210})
    await scene.book.load(ANNA, recipe, monotonic_now(), confirm=True, command_id="one")
    live = a_bus()
    again = RecipeBook(live, {"dry-end": scene.commands}, scene.book.store, scene.events)  # type: ignore[arg-type]
    await again.load_marks()
    assert again.loaded_words("dry-end") == ("Kraft 80", [])
    responding(live, commanded=1200)
    assert again.loaded_words("dry-end") == ("Kraft 80", ["Nip"])
    del live.buses["dry-end"].units[2]
    assert [(one.name, one.now) for one in again.departed("dry-end")] == [
        (Message.of("unit_address", unit=2), NOT_CONFIGURED)
    ]
    assert not again.try_out(ANNA, recipe).loadable


async def test_the_dry_run_explains_what_will_happen(scene: Scene) -> None:
    responding(scene.live, commanded=1000)
    scene.live.buses["dry-end"].apply(
        [ParameterValue(unit=2, number=number, at=2.0, raw=raw) for number, raw in FOLLOWER.items()]
    )
    recipe = await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {1: 11000, 2: 10100})
    effects = [in_english(step.effect) for step in scene.book.try_out(ANNA, recipe).steps]
    assert effects == [
        "speeds up from 100.0 to 1100.0 in 5.0 s",
        "follows at 1.0100 of its master instead of 1.0000",
    ]


async def test_a_ratio_read_before_the_recipe_was_loaded_is_no_departure(scene: Scene) -> None:
    responding(scene.live)
    follower = [ParameterValue(unit=2, number=number, at=2.0, raw=raw) for number, raw in FOLLOWER.items()]
    scene.live.buses["dry-end"].apply(follower)
    recipe = await scene.book.save(ANNA, "dry-end", "Kraft 80", "", {2: 10100})
    await scene.book.load(ANNA, recipe, monotonic_now(), confirm=True, command_id="one")
    assert scene.book.departed("dry-end") == []
    loaded = scene.book.loaded("dry-end")
    assert loaded is not None
    scene.live.buses["dry-end"].apply([ParameterValue(unit=2, number=37, at=loaded.at + 60, raw=9900)])
    assert [str(one.now) for one in scene.book.departed("dry-end")] == ["0.9900"]


FOLLOWER = {8: 1, 37: 10000}


def a_recipe(*setpoints: RecipeSetpoint) -> Recipe:
    return Recipe("dry-end", "Kraft 80", "", "anna", 0.0, setpoints)


def steps_of(live: LiveState, *setpoints: RecipeSetpoint) -> tuple[RecipeDryRunStep, ...]:
    return dry_run(a_recipe(*setpoints), live.buses["dry-end"], lambda _unit, _raw: None, unix_now()).steps


def test_a_unit_that_is_not_configured_is_named_by_its_address() -> None:
    [step] = steps_of(a_bus(), RecipeSetpoint(9, 1200, "speed"))
    assert (step.name, step.obstacle) == (Message.of("unit_address", unit=9), NOT_CONFIGURED)


def test_what_a_unit_has_now_is_unknown_until_it_was_read() -> None:
    [step] = steps_of(a_bus(), RecipeSetpoint(1, 1200, "speed"))
    assert (step.old, in_english(step.effect)) == (None, "becomes 1200 raw; what it has now is not known")


def test_a_unit_whose_mode_was_not_read_cannot_be_loaded() -> None:
    live = a_bus()
    live.buses["dry-end"].apply([BusLink(at=1.0, link="open"), UnitLink(unit=1, at=1.0, link="online")])
    live.buses["dry-end"].apply([Reading(1, fresh(), 1000, 1000, 0, REMOTE, HEALTHY)])
    [step] = steps_of(live, RecipeSetpoint(1, 1200, "speed"))
    assert step.obstacle == Message("recipe_mode_unread")


@pytest.mark.parametrize(
    ("setpoint", "reason"),
    [
        (RecipeSetpoint(9, 1200, "speed"), NOT_CONFIGURED),
        (RecipeSetpoint(1, 1200, "speed", "2:20000,8:0,3:1"), None),
        (RecipeSetpoint(1, 1200, "speed", "2:20000,8:0,3:2"), Message("recipe_other_scale")),
    ],
)
def test_a_setpoint_fits_a_unit_that_has_the_scale_it_was_saved_with(
    setpoint: RecipeSetpoint, reason: Message | None
) -> None:
    live = a_bus()
    responding(live)
    assert why_not_setpoint(setpoint, live.buses["dry-end"]) == reason


def test_a_recipe_begins_from_the_setpoints_that_are_known() -> None:
    live = a_bus()
    bus = live.buses["dry-end"]
    assert setpoints_now(bus, unix_now()) == ()
    responding(live, commanded=1000)
    follower = [
        ParameterValue(unit=2, number=number, at=2.0, raw=raw) for number, raw in ((8, 1), (37, 9900))
    ]
    live.buses["dry-end"].apply(follower)
    assert setpoints_now(bus, unix_now()) == (
        RecipeSetpoint(1, 1000, "speed", "2:20000,8:0,3:1"),
        RecipeSetpoint(2, 9900, "ratio", "8:1"),
    )
    later = unix_now() + 700.0
    assert setpoints_now(bus, UnixTime(later)) == (), "nothing has reported them for a minute"
    recipe = Recipe("dry-end", "White", "", "anna", UnixTime(0.0), (RecipeSetpoint(1, 900, "speed"),))
    (step,) = dry_run(recipe, bus, lambda *_: None, UnixTime(later)).steps
    assert (step.old, step.obstacle) == (None, Message("obstacle_offline"))


async def load(client: httpx.AsyncClient, **changed: str) -> httpx.Response:
    form = {"id": "c" * 32, "reviewed_at": str(time.time()), "raw-1": "700", "was-1": ""}
    form |= {"scale-1": "8:0,3:1", **changed}
    return await client.post("/recipes/1/load", data=form, headers={"Origin": str(client.base_url)})


@for_each(
    ("changed", "expected"),
    [
        ({"reviewed_at": "1"}, "expired"),
        ({"reviewed_at": "nan"}, "expired"),
        ({"was-1": "690"}, "changed since the review"),
        ({"raw-1": "710"}, "differs from the review"),
        ({"raw-1": ""}, "differs from the review"),
        ({}, "cannot be loaded now"),
        ({"leave-out": "x"}, "differs from the review"),
        ({"leave-out": "1"}, "every unit of Board is left out"),
    ],
)
async def test_only_what_was_reviewed_is_loaded(house: House, changed: dict[str, str], expected: str) -> None:
    unit_1 = [ParameterValue(unit=1, number=number, at=1, raw=raw) for number, raw in ((3, 1), (8, 0))]
    house.services[LiveState].buses["dry-end"].apply(list(unit_1))
    await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 700})
    response = await load(await house.signed_in(Role.OPERATOR), **changed)
    assert expected in response.text
    assert 'data-review-done="bad"' in response.text


async def test_the_review_watches_no_unit_that_is_left_out(house: House) -> None:
    """Its last setpoint would end the review: nothing is known of the present one."""
    bus = house.services[LiveState].buses["dry-end"]
    known = [ParameterValue(unit=1, number=number, at=1.0, raw=raw) for number, raw in ((3, 1), (8, 0))]
    bus.apply([BusLink(at=1.0, link="open"), Reading(1, 1.0, 700, 700, 0, REMOTE, HEALTHY), *known])
    recipe = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 700})
    operator = await house.signed_in(Role.OPERATOR)
    review = await operator.get(f"/recipes/{recipe.id}/review")
    first, _, table = review.text.partition("<table")
    assert "Leave out Unwind" in first, "what needs a tick comes first"
    assert "First tick the box above" in table
    assert "data-watch" not in review.text


async def test_the_review_begins_with_the_draws_that_change(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Below the rows of eight units they were out of sight."""
    responding(house.services[LiveState])
    draw = DrawChange(Message.of("draws_stay", names=["Nip"]), is_out=True)
    monkeypatch.setattr("app.engineering.recipes.feature.draw_changes", lambda *_: [draw])
    recipe = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 700})
    review = await (await house.signed_in(Role.OPERATOR)).get(f"/recipes/{recipe.id}/review")
    assert 'class="draws"' in review.text.partition("<table")[0]


async def test_the_name_of_a_unit_is_no_word_of_the_page(house: House) -> None:
    unit = house.services[LiveState].buses["dry-end"].units[1]
    house.services[LiveState].buses["dry-end"].apply([ParameterValue(unit=1, number=8, at=1, raw=0)])
    object.__setattr__(unit.settings, "name", "Line")
    recipe = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 700})
    viewer = await house.signed_in(Role.VIEWER)
    page = await viewer.get(f"/recipes/{recipe.id}", headers={"Accept-Language": "de"})
    assert '<th scope="row">Line</th>' in page.text


async def test_a_recipe_is_retired_after_a_review(house: House) -> None:
    responding(house.services[LiveState])
    recipe = await recipe_of(house, "board", 500)
    person = await house.signed_in(Role.ENGINEER)
    review = await person.get(f"/recipes/{recipe.id}/retire", headers={"hx-request": "true"})
    assert "can no longer be loaded" in review.text
    assert "board" in (await person.get("/recipes")).text
    await person.post(f"/recipes/{recipe.id}/retire")
    assert "No recipe is saved yet" in (await person.get("/recipes")).text


async def test_programs_see_what_a_load_would_do_and_what_departed(house: House) -> None:
    bus = house.services[LiveState].buses["dry-end"]
    bus.apply([ParameterValue(unit=1, number=number, at=1, raw=raw) for number, raw in ((3, 1), (8, 0))])
    recipe = await house.services[RecipeBook].save(ANNA, "dry-end", "Board", "", {1: 700})
    viewer = await house.signed_in(Role.VIEWER)
    run = (await viewer.get(f"/api/v1/recipes/{recipe.id}/dry-run")).json()
    [step] = run["units"]
    assert (run["loadable"], step["id"], step["name"], step["raw"], step["new"]) == (
        False,
        1,
        "Unwind",
        700,
        "70.0",
    )
    assert (step["old"], step["ramp_s"], step["obstacle"]["code"]) == (None, None, "obstacle_no_link")
    assert step["effect"]["detail"].startswith("becomes 70.0")
    assert not {"measure", "risks"} & step.keys()
    await house.services[RecipeBook].store.mark_loaded("dry-end", recipe.id, "anna", time.time())
    await house.services[RecipeBook].load_marks()
    del bus.units[1]
    [departed] = (await viewer.get("/api/v1/buses/dry-end/recipe")).json()["departed"]
    assert (departed["id"], departed["name"], departed["recipe"]) == (1, "unit 1", "700")
    assert departed["now"]["code"] == "unit_not_configured"


API = "/api/v1"
KEY = {"Idempotency-Key": "mine-1"}
Sends = Callable[[], Awaitable[httpx.Response]]


@pytest.fixture
async def line(house: House) -> PlayedLine:
    line = await played_line(house.services)
    for unit, memory in line.memory.items():
        values = [ParameterValue(unit, number, unix_now(), raw) for number, raw in memory.items()]
        line.live.buses[BUS].apply(values)
    return line


async def sent(line: PlayedLine, *sends: Sends) -> list[httpx.Response]:
    """The responses to requests at the same time, of which one command becomes verified."""
    before = len(line.held)
    waiting = [asyncio.create_task(each()) for each in sends]  # type: ignore[arg-type]
    await until(lambda: len(line.held) > before, "the command")
    line.end("verified")
    return await asyncio.gather(*waiting)


async def recipe_of(house: House, name: str, raw: int) -> Recipe:
    return await house.services[RecipeBook].save(ANNA, BUS, name, "", {1: raw})


async def loads(house: House) -> int:
    """The number of events that a recipe was loaded."""
    return sum("loaded" in event["what"] for event in await house.events("recipe"))


def lose(line: PlayedLine) -> None:
    """Now no unit could take a command."""
    for unit in line.memory:
        line.live.buses[BUS].apply([UnitLink(unit=unit, at=unix_now(), link="offline")])


async def test_a_recipe_is_loaded_once(house: House, line: PlayedLine) -> None:
    recipe, other = await recipe_of(house, "Kraft 80", 700), await recipe_of(house, "Board", 800)
    program = await house.program(Role.ENGINEER)

    async def load(of: Recipe = recipe, key: str = "mine-1") -> httpx.Response:
        headers = {"Idempotency-Key": key}
        return await program.post(f"{API}/recipes/{of.id}/load", json={"confirm": True}, headers=headers)

    first, second = await sent(line, load, load)
    assert (first.status_code, first.json()["outcome"], second.text) == (200, "verified", first.text)
    await sent(line, lambda: load(other, "mine-2"))
    assert await loads(house) == 2
    lose(line)
    again = await load()
    assert (again.status_code, again.text) == (200, first.text)
    assert [command.action for command in line.held] == [SetLine({1: 700}), SetLine({1: 800})]
    assert await loads(house) == 2
    loaded = house.services[RecipeBook].loaded(BUS)
    assert loaded is not None
    assert loaded.recipe.name == "Board", "the one that was loaded last"
    assert (await load(other)).status_code == 422, "the id is of another recipe"
    assert (await load(key="mine-3")).status_code == 409, "under a new id the line is judged as it is"


async def test_a_form_of_a_recipe_shows_its_result_again(house: House, line: PlayedLine) -> None:
    recipe, browser = await recipe_of(house, "Kraft 80", 700), await house.signed_in(Role.ENGINEER)
    form = {"id": "form-id-1", "reviewed_at": unix_now(), "raw-1": "700", "was-1": "0"}
    form["scale-1"] = "-"
    path = f"/recipes/{recipe.id}/load"
    await assert_one_command(line, lambda: post(browser, path, form), SetLine({1: 700}))
    assert await loads(house) == 1


@pytest.mark.parametrize(
    ("path", "action"), [("units/1/execute", ExecuteSpeed(unit=1)), ("execute", ExecuteAll())]
)
async def test_a_staged_speed_is_executed_once(
    house: House, line: PlayedLine, path: str, action: object
) -> None:
    program = await house.program(Role.OPERATOR)
    stage(line)

    async def execute() -> httpx.Response:
        return await program.post(f"{API}/buses/{BUS}/{path}", headers=KEY)

    first, second = await sent(line, execute, execute)
    lose(line)
    again = await execute()
    assert {each.text for each in (second, again)} == {first.text}
    assert (first.status_code, first.json()["id"]) == (200, "mine-1")
    assert [command.action for command in line.held] == [action]


async def test_a_form_of_execute_staged_shows_its_result_again(house: House, line: PlayedLine) -> None:
    browser = await house.signed_in(Role.OPERATOR)
    stage(line)
    form = {"id": "form-id-1", "reviewed_at": unix_now(), "raw": "500", "was": "0"}
    form["scale"] = "-"
    path = f"/units/{BUS}/1/execute"
    await assert_one_command(line, lambda: post(browser, path, form), ExecuteSpeed(unit=1))
    other = await post(browser, path, {**form, "id": "form-id-2"})
    assert (other.status_code, "staged" in other.text) == (409, True), "nothing is staged by now"


def stage(line: PlayedLine, raw: int | None = 500) -> None:
    line.live.buses[BUS].apply([Staged(unit=1, at=unix_now(), raw=raw)])


async def post(browser: httpx.AsyncClient, path: str, form: dict[str, Any]) -> httpx.Response:
    return await browser.post(path, data=form, headers={"hx-request": "true"})


async def assert_one_command(line: PlayedLine, send: Sends, action: object) -> None:
    """Of a form that is pressed twice, and arrives again once nothing is as it was reviewed."""
    first, second = await sent(line, send, send)
    stage(line, None)
    lose(line)
    line.live.buses[BUS].apply([BusLink(at=unix_now(), link="closed")])
    again = await send()
    assert [each.status_code for each in (first, second, again)] == [200, 200, 200], again.text
    assert all("verified" in each.text for each in (first, second, again))
    assert [command.action for command in line.held] == [action]
