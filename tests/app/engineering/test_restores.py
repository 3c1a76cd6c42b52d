"""Restores: each row with its outcome, whatever stops them, finished by another run; also over HTTP."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal

import httpx
import pytest

from app.core.database import Database
from app.core.web.access import Person, Role
from app.engineering.sets.model import ParameterRow, UnitRows
from app.engineering.sets.restore_plan import Restore, Selection, Write
from app.engineering.sets.restore_service import RestoreService, RestoreStore
from app.engineering.sets.saving import ParameterReader
from app.errors import Problem
from bus.contract import Result, UnitLink, WriteParameter
from bus.instants import UnixTime
from bus.messages import Message
from tests.app.complete_app import House
from tests.app.fake_worker import until
from tests.app.played_commands import ANNA, Noted, PlayedCommands, a_bus, factory, responding
from tests.app.played_line import BUS, PlayedLine, played_line
from tests.for_each import for_each

BEN = Person("ben", Role.ENGINEER, "session")
WANTED = {6: 50, 7: 60, 12: 7, 9: 1234}
RAMPS = "Acceleration Ramp Rate (parameter 6), Deceleration Ramp Rate (parameter 7)"
WINDOW, PRESET = "Up to Speed Tolerance (parameter 12)", "Preset Speed (parameter 9)"


def rows(values: dict[int, int]) -> UnitRows:
    return UnitRows(2, "Nip", {number: ParameterRow(number, raw) for number, raw in values.items()})


class Scene:
    def __init__(self, database: Database, **commands: object) -> None:
        self.live = live = a_bus()
        responding(live)
        self.commands = PlayedCommands(live, {1: factory(), 2: factory()}, **commands)  # type: ignore[arg-type]
        self.events = Noted()
        reader = ParameterReader(live.buses["dry-end"], self.commands)  # type: ignore[arg-type]
        self.reader, self.store = reader, RestoreStore(database)
        self.restores = self.server()

    def server(self) -> RestoreService:
        """Return the restore service of a server that has just been started."""
        return RestoreService({"dry-end": self.reader}, {"dry-end": self.commands}, self.events, self.store)  # type: ignore[arg-type]

    async def plan(self, wanted: dict[int, int] = WANTED, **chosen: frozenset[int]) -> Restore:
        return await self.restores.plan(ANNA, "dry-end", 2, rows(wanted), Selection(**chosen))

    async def run(self, wanted: dict[int, int] = WANTED, **chosen: frozenset[int]) -> Restore:
        restore = await self.plan(wanted, **chosen)
        await self.finish(restore)
        return restore

    async def finish(self, restore: Restore) -> None:
        self.events.noted.clear()
        self.restores.start(ANNA, restore)
        await asyncio.wait_for(self.events.noted.wait(), 10)


SetsScene = Callable[..., Scene]


@pytest.fixture
def a_scene(tmp_path: Path) -> Iterator[SetsScene]:
    database = Database(tmp_path / "lineside.db")
    yield partial(Scene, database)
    database.close()


async def test_nothing_is_written_before_the_start(a_scene: SetsScene) -> None:
    scene = a_scene()
    restore = await scene.plan()
    assert scene.commands.written == []
    assert (restore.state, restore.done) == ("planned", 0)
    assert [row.write.number for row in restore.rows] == [6, 7, 12, 9]


async def test_only_differences_are_written_and_a_full_read_verifies_them(a_scene: SetsScene) -> None:
    scene = a_scene()
    scene.commands.memory[2][6] = 50
    restore = await scene.run()
    assert scene.commands.written == [(2, 7, 60), (2, 12, 7), (2, 9, 1234)]
    assert restore.state == "equal"
    assert restore.remaining == []
    assert {row.outcome for row in restore.rows} == {"verified"}
    assert scene.events.events[-1]["outcome"] == "equal"


async def test_one_refused_row_does_not_cost_the_others(a_scene: SetsScene) -> None:
    scene = a_scene(refuses={7: 0x83})
    restore = await scene.run()
    results = {row.write.number: row.outcome for row in restore.rows}
    assert results == {6: "verified", 7: "refused", 9: "verified", 12: "verified"}
    assert str(restore.rows[1].message) == "refused: illegal parameter value"
    assert restore.state == "different"
    assert restore.remaining is not None
    assert [row.number for row in restore.remaining] == [7]


async def test_a_timeout_stops_it_and_a_second_run_finishes_the_rest(a_scene: SetsScene) -> None:
    scene = a_scene(timeout_after=2)
    restore = await scene.run()
    assert restore.state == "stopped"
    assert "no response" in str(restore.cause)
    assert [row.outcome for row in restore.rows] == ["verified", "verified", "unverified", "not_sent"]
    scene.commands.timeout_after = None
    again = await scene.run()
    assert [row.write.number for row in again.rows] == [12, 9]
    assert again.state == "equal"


async def test_a_canceled_restore_lists_the_rows_done(a_scene: SetsScene) -> None:
    scene = a_scene()
    restore = await scene.plan()
    scene.restores.cancel(BEN, restore)
    await scene.finish(restore)
    assert restore.state == "stopped"
    assert restore.cause == Message.of("restore_left_off", who="ben", done=0, n=4)
    assert str(restore.cause) == "canceled by ben after 0 of 4 rows"
    assert {row.outcome for row in restore.rows} == {"not_sent"}
    assert scene.commands.written == []


async def test_it_starts_once_and_one_at_a_time_for_a_unit(a_scene: SetsScene) -> None:
    scene = a_scene()
    one = await scene.plan()
    other = await scene.plan()
    scene.restores.start(ANNA, one)
    for restore in (one, other):
        with pytest.raises(Problem):
            scene.restores.start(ANNA, restore)
    await asyncio.wait_for(scene.events.noted.wait(), 10)
    assert one.state == "equal"
    with pytest.raises(Problem):
        scene.restores.start(ANNA, one)


async def test_a_unit_with_the_first_twenty_parameters_only(a_scene: SetsScene) -> None:
    scene = a_scene(lacks=frozenset(range(21, 41)))
    restore = await scene.run(WANTED | {29: 5, 39: 3})
    assert {left.number: left.reason for left in restore.left_out}[29] == "not_in_unit"
    assert restore.state == "equal"


async def test_a_unit_that_does_not_respond_has_no_plan(a_scene: SetsScene) -> None:
    scene = a_scene(timeout_after=0)
    with pytest.raises(Problem) as refused:
        await scene.plan()
    assert refused.value.status == 504
    assert scene.commands.written == []


@pytest.mark.parametrize("outcome", ["bus_closed", "not_sent"])
async def test_a_request_that_did_not_reach_the_unit_says_so(
    a_scene: SetsScene, monkeypatch: pytest.MonkeyPatch, outcome: Literal["bus_closed", "not_sent"]
) -> None:
    scene = a_scene()

    async def send(*_: Any, **__: Any) -> Result:
        return Result("id", UnixTime(1.0), outcome)

    monkeypatch.setattr(scene.commands, "send", send)
    with pytest.raises(Problem) as refused:
        await scene.plan()
    assert (refused.value.status, refused.value.code) == (503, outcome)


async def test_a_killed_server_left_the_exact_list_of_what_was_done(a_scene: SetsScene) -> None:
    scene = a_scene(hangs_after=2)
    killed = await scene.plan()
    scene.restores.start(ANNA, killed)
    await asyncio.wait_for(scene.commands.hanging.wait(), 10)

    after = scene.server()
    await after.load()
    found = await after.find(killed.id)
    assert found is not None
    assert (found.state, found.who) == ("stopped", "anna")
    assert [row.outcome for row in found.rows] == ["verified", "verified", "unverified", "not_sent"]
    assert scene.events.events[-1]["outcome"] == "stopped"
    assert scene.events.events[-1]["message"].endswith(
        f"done: {RAMPS}; not verified: {WINDOW}; not written: {PRESET}"
    )
    await scene.restores.background.close()

    scene.commands.hangs_after, scene.restores = None, after
    again = await scene.run()
    assert [row.write.number for row in again.rows] == [12, 9]
    assert [one.id for one in await after.of_unit("dry-end", 2)] == [again.id, killed.id]
    assert (await scene.server().find(again.id)) is not None


async def test_what_a_restore_found_is_the_same_after_the_next_start(a_scene: SetsScene) -> None:
    scene = a_scene(refuses={7: 0x83})
    restore = await scene.run(WANTED | {18: 48})
    kept = await scene.server().find(restore.id)
    assert kept is not None
    assert (kept.state, kept.rows, kept.left_out) == (restore.state, restore.rows, restore.left_out)
    assert kept.remaining is not None
    assert [row.number for row in kept.remaining] == [7]


async def test_a_stored_restore_holds_nothing_of_the_operator_password(a_scene: SetsScene) -> None:
    scene = a_scene()
    restore = await scene.run({6: 50, 21: 4711})
    assert scene.commands.memory[2][21] == 4711
    kept = await scene.server().find(restore.id)
    assert kept is not None
    assert [(row.write, row.read_back) for row in kept.rows if row.write.number == 21] == [
        (Write(21, -1, -1), None)
    ]
    assert all(side is not None and side.raw(21) is None for side in (kept.wanted, kept.before, kept.proven))
    select = "SELECT content FROM restore"
    [[content]] = await scene.store.database.read(lambda connection: connection.execute(select).fetchall())
    assert "4711" not in content


async def test_a_stored_restore_that_cannot_be_read_is_left_out(a_scene: SetsScene) -> None:
    scene = a_scene()
    kept, broken = await scene.run(), await scene.run({6: 51})
    update = "UPDATE restore SET content = '{}' WHERE id = ?"
    await scene.store.database.write(lambda connection: connection.execute(update, (broken.id,)))
    assert [one.id for one in await scene.server().of_unit("dry-end", 2)] == [kept.id]
    assert await scene.server().find(broken.id) is None


async def test_a_unit_in_local_is_reported_beforehand_and_is_not_called_equal(a_scene: SetsScene) -> None:
    scene = a_scene()
    scene.commands.memory[2][19] = 0
    responding(scene.live, remote=False)
    restore = await scene.run()
    assert scene.commands.written == []
    assert {left.number for left in restore.left_out if left.later} == set(WANTED)
    assert restore.state == "different"


async def test_a_running_unit_keeps_its_setpoint_unless_it_was_chosen(a_scene: SetsScene) -> None:
    scene = a_scene()
    scene.commands.memory[2] |= {20: 1216, 37: 9000}
    restore = await scene.run(WANTED | {20: 1134, 37: 10000})
    assert {number for _, number, _ in scene.commands.written} == set(WANTED)
    assert restore.state == "equal"
    assert {20: "operating_value", 37: "operating_value"}.items() <= {
        left.number: left.reason for left in restore.left_out
    }.items()
    chosen = await scene.run({20: 1134, 37: 10000}, include=frozenset({20}))
    assert scene.commands.written[-1] == (2, 20, 1134)
    assert (chosen.state, scene.commands.memory[2][37]) == ("equal", 9000)


async def test_a_deselected_row_is_not_written_and_not_missed(a_scene: SetsScene) -> None:
    scene = a_scene()
    restore = await scene.run(exclude=frozenset({7, 9}))
    assert scene.commands.written == [(2, 6, 50), (2, 12, 7)]
    assert restore.state == "equal"
    assert [left.number for left in restore.left_out if left.reason == "deselected"] == [7, 9]


async def test_a_plan_takes_another_choice_until_it_begins(a_scene: SetsScene) -> None:
    scene = a_scene()
    restore = await scene.plan(WANTED | {20: 5})
    scene.restores.select(ANNA, restore, Selection(include=frozenset({20}), exclude=frozenset({6})))
    await scene.finish(restore)
    assert {number for _, number, _ in scene.commands.written} == {7, 9, 12, 20}
    with pytest.raises(Problem) as refused:
        scene.restores.select(ANNA, restore, Selection())
    assert refused.value.code == "already_started"


@pytest.mark.parametrize(("number", "raw"), [(6, 51), (15, 99)], ids=["to be written", "equal before"])
async def test_a_value_that_moved_since_the_review_stops_it(
    a_scene: SetsScene, number: int, raw: int
) -> None:
    scene = a_scene()
    wanted = WANTED | {15: scene.commands.memory[2][15]}
    restore = await scene.plan(wanted)
    scene.commands.memory[2][number] = raw
    await scene.finish(restore)
    assert (restore.state, restore.cause_code, scene.commands.written) == ("stopped", "moved", [])
    assert {row.outcome for row in restore.rows} == {"not_sent"}
    kept = await scene.server().find(restore.id)
    assert kept is not None
    assert (kept.cause_code, kept.rows) == ("moved", restore.rows)


async def test_a_setpoint_that_moves_stops_no_restore_that_leaves_it_alone(a_scene: SetsScene) -> None:
    scene = a_scene()
    restore = await scene.plan(WANTED | {20: 1134})
    scene.commands.memory[2][20] = 1300
    await scene.finish(restore)
    assert (restore.state, scene.commands.memory[2][20]) == ("equal", 1300)


async def test_a_unit_that_is_started_meanwhile_is_not_changed_unreviewed(a_scene: SetsScene) -> None:
    scene = a_scene()

    def press_run(action: WriteParameter) -> None:
        if action.number == 6:
            responding(scene.live, run=True)

    scene.commands.before_write = press_run
    restore = await scene.run({2: 1, 6: 50, 7: 60, 12: 7})
    assert (restore.state, restore.cause_code) == ("stopped", "moved")
    assert [(row.write.number, row.outcome) for row in restore.rows] == [
        (2, "verified"),
        (6, "verified"),
        (7, "not_sent"),
        (12, "not_sent"),
    ]


async def test_a_unit_that_ran_at_the_review_may_go_on_running(a_scene: SetsScene) -> None:
    scene = a_scene()
    responding(scene.live, run=True)
    restore = await scene.run()
    assert (restore.running, restore.state) == (True, "equal")


async def test_an_objection_to_one_row_does_not_cost_the_others(a_scene: SetsScene) -> None:
    scene = a_scene(
        objects={7: Problem(422, "invalid", Message.of("system_error", error="above the engineer's limit"))}
    )
    restore = await scene.run()
    assert [row.outcome for row in restore.rows] == ["verified", "invalid", "verified", "verified"]
    assert str(restore.rows[1].message) == "above the engineer's limit"
    assert restore.state == "different"


@pytest.mark.parametrize("code", ["rights_withdrawn", "controlled", "blocked"])
async def test_an_objection_to_the_requester_stops_it_between_two_rows(a_scene: SetsScene, code: str) -> None:
    scene = a_scene(objects={12: Problem(403, code, Message.of("system_error", error="no longer"))})
    restore = await scene.run()
    assert (restore.state, restore.cause_code, str(restore.cause)) == ("stopped", code, "no longer")
    assert [row.outcome for row in restore.rows] == ["verified", "verified", "not_sent", "not_sent"]
    assert scene.events.events[-1]["message"] == f"no longer; done: {RAMPS}; not written: {WINDOW}, {PRESET}"


PLANS = f"/api/v1/buses/{BUS}/units/2/restores"
DRIFTED = {6: 50, 7: 60, 20: 1216, 37: 9000, 27: 1}
"""What the set has; the unit has left it."""


@pytest.fixture
async def line(house: House) -> PlayedLine:
    return await played_line(house.services)


@pytest.fixture
async def golden(client: httpx.AsyncClient, line: PlayedLine) -> int:
    """A set of the unit, golden; another is newer, and the unit has drifted since."""
    line.memory[2] |= DRIFTED
    number = int((await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [2]})).json()["id"])
    await client.post(f"/api/v1/sets/{number}/golden", json={"unit": 2})
    await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [1, 2]})
    line.memory[2] |= {6: 51, 7: 61, 20: 1000, 37: 9500, 27: 0}
    return number


async def plan(client: httpx.AsyncClient, golden: int, **chosen: Any) -> Any:
    response = await client.post(PLANS, json={"set": golden, **chosen})
    assert response.status_code == 201, response.text
    return response.json()


async def ended(house: House, client: httpx.AsyncClient, restore: str) -> Any:
    found = await house.services[RestoreService].find(restore)
    assert found is not None
    await until(lambda: found.state in ("equal", "different", "stopped"), "the end of the restore")
    return (await client.get(f"/api/v1/restores/{restore}")).json()


def selected(planned: Any) -> dict[int, bool]:
    return {row["number"]: row["selected"] for row in planned["rows"]}


async def test_a_plan_shows_which_rows_are_selected_and_why_not(
    client: httpx.AsyncClient, golden: int
) -> None:
    planned = await plan(client, golden)
    assert selected(planned) == {6: True, 7: True, 20: False, 37: False}
    setpoint = next(row for row in planned["rows"] if row["number"] == 20)
    assert (setpoint["reason_code"], setpoint["effect"]) == ("operating_value", "setpoint")
    assert (setpoint["present_raw"], setpoint["wanted_raw"]) == (1000, 1216)
    assert setpoint["reason"] == setpoint["warning"]
    assert setpoint["reason"]["detail"] == "Changes the machine's speed now"
    left = {row["number"]: (row["reason_code"], row["differs"]) for row in planned["left_out"]}
    assert left == {20: ("operating_value", True), 27: ("dangerous", True), 37: ("operating_value", True)}
    chosen = await plan(client, golden, include=[20], exclude=[6], ticked=[27])
    assert selected(chosen) == {6: False, 7: True, 20: True, 27: True, 37: False}


@pytest.mark.parametrize(("chosen", "written"), [({"include": []}, {7}), ({"exclude": [7]}, {6, 20})])
async def test_the_start_may_choose_other_rows(
    house: House,
    client: httpx.AsyncClient,
    line: PlayedLine,
    golden: int,
    chosen: dict[str, list[int]],
    written: set[int],
) -> None:
    planned = await plan(client, golden, include=[20], exclude=[6])
    await client.post(f"/api/v1/restores/{planned['id']}/start", json=chosen)
    assert (await ended(house, client, planned["id"]))["state"] == "equal"
    assert {number for _, number, _ in line.written} == written


@for_each(
    ("chosen", "status", "code"),
    [
        ({"include": [27]}, 409, "dangerous"),
        ({"include": [6], "exclude": [6]}, 422, "invalid"),
        ({"include": [20, 20]}, 422, "invalid"),
        ({"includes": [20]}, 422, "invalid"),
    ],
)
async def test_a_choice_that_cannot_be_is_refused(
    client: httpx.AsyncClient, line: PlayedLine, golden: int, chosen: dict[str, Any], status: int, code: str
) -> None:
    refused = await client.post(PLANS, json={"set": golden, **chosen})
    assert (refused.status_code, refused.json()["code"]) == (status, code)
    planned = await plan(client, golden)
    refused = await client.post(f"/api/v1/restores/{planned['id']}/start", json=chosen)
    assert (refused.status_code, refused.json()["code"]) == (status, code)
    assert line.written == []


async def test_the_page_selects_the_golden_set_and_writes_checked_rows(
    house: House, client: httpx.AsyncClient, line: PlayedLine, golden: int
) -> None:
    page = (await client.get(f"/units/{BUS}/2/restore")).text
    assert re.findall(r'value="([^"]*)" selected', page) == [f"set:{golden}:2"]
    own, others = page.split('<optgroup label="Sets of other units', 1)
    assert own.count("<option") == 3
    assert "unit 1" in others
    review = await client.post(f"/units/{BUS}/2/restore", data={"source": f"set:{golden}:2"})
    path = review.headers["location"]
    page = (await client.get(path)).text
    assert re.findall(r'name="row" value="(\d+)" checked', page) == ["6", "7"]
    assert re.findall(r'name="row" value="(\d+)" aria', page) == ["20", "37"]
    for rows, words in (([], "no row was chosen"), (["5"], "differs from the review")):
        refused = await client.post(f"{path}/start", data={"row": rows})
        assert (refused.status_code, words in refused.text) == (422, True)
    assert (await client.post(f"{path}/start", data={"row": ["6", "20"]})).status_code == 303
    end = await ended(house, client, path.rpartition("/")[2])
    assert end["state"] == "equal"
    assert {number for _, number, _ in line.written} == {6, 20}
    assert {row["number"]: row["reason_code"] for row in end["left_out"] if row["differs"]} == {
        7: "deselected",
        27: "dangerous",
        37: "operating_value",
    }


async def test_a_second_look_keeps_what_was_deselected_and_no_setpoint(
    house: House, client: httpx.AsyncClient, line: PlayedLine, golden: int
) -> None:
    planned = await plan(client, golden, include=[20], exclude=[6])
    line.memory[2][7] = 62
    await client.post(f"/api/v1/restores/{planned['id']}/start")
    await ended(house, client, planned["id"])
    again = await client.post(f"/restores/{planned['id']}/again")
    fresh = (await client.get(f"/api/v1{again.headers['location']}")).json()
    assert selected(fresh) == {6: False, 7: True, 20: False, 37: False}


async def test_a_restore_that_ended_early_has_a_mark_and_its_cause(
    house: House, client: httpx.AsyncClient, golden: int, line: PlayedLine
) -> None:
    planned = await plan(client, golden)
    restore = await house.services[RestoreService].find(planned["id"])
    assert restore is not None
    restore.stop("canceled", Message.of("restore_left_off", who="ben", done=0, n=4))
    page = (await client.get(f"/restores/{planned['id']}", headers={"accept": "text/html"})).text
    assert "outcome--bad" in page
    assert "The restore ended early. Review the remaining rows to finish it.<br><small>canceled" in page
    assert line.written == []


async def test_confirming_a_danger_plans_again_with_it(
    client: httpx.AsyncClient, line: PlayedLine, golden: int
) -> None:
    planned = await plan(client, golden)
    ticked = await client.post(f"/restores/{planned['id']}/tick", data={"tick": ["27"]})
    fresh = (await client.get(f"/api/v1{ticked.headers['location']}")).json()
    assert selected(fresh) == {6: True, 7: True, 27: True, 20: False, 37: False}
    assert line.written == []
    assert fresh["id"] != planned["id"]


@pytest.mark.usefixtures("line")
async def test_a_list_of_sets_links_to_its_next_page(client: httpx.AsyncClient) -> None:
    for _ in range(3):
        saved = await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [1]})
        assert saved.status_code == 201, saved.text
    pages, path = [], f"/api/v1/sets?bus={BUS}&limit=2"
    while path:
        response = await client.get(path)
        pages.append([each["id"] for each in response.json()])
        path = response.links["next"]["url"] if response.links else ""
    assert [len(page) for page in pages] == [2, 1]
    found = [number for page in pages for number in page]
    assert found == sorted(set(found), reverse=True)


@pytest.mark.usefixtures("golden")
async def test_golden_sets_of_a_line_are_reviewed_before_any_unit_is_read(
    client: httpx.AsyncClient, house: House
) -> None:
    await client.get(f"/api/v1/buses/{BUS}/units/2/parameters", params={"refresh": "true"})
    house.live.apply([UnitLink(unit=1, at=time.time(), link="offline")])
    stored = (await client.get("/api/v1/sets")).json()
    review = (await client.get("/sets/golden", params={"bus": BUS})).text
    assert re.findall(r'name="unit" value="(\d+)"', review) == ["2"]
    assert "Save golden set of 1 unit" in review
    assert 'data-remark="golden_not_read"' in review
    assert 'data-remark="golden_not_at_speed"' in review
    assert "<b>3 values</b>" in review
    assert (await client.get("/api/v1/sets")).json() == stored
    confirmed = {"bus": BUS, "golden": "true", "unit": ["2"]}
    saved = await client.post("/sets/take", data=confirmed, headers={"HX-Request": "true"})
    assert saved.headers["HX-Redirect"].startswith("/sets/taking/")
