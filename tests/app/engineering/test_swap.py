"""Replacing a unit: from what the wire shows to what a person does, and the form that begins it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import httpx
import pytest

from app.core.database import Database
from app.core.web.access import Person
from app.engineering.sets.lookup import offers
from app.engineering.sets.model import ParameterRow, ParameterSet, ParameterSetSummary, UnitRows
from app.engineering.sets.restore_plan import LeftOut, Restore, RestorePlan, RestoreState, RowResult, Write
from app.engineering.sets.restore_service import EndSubscriber, RestoreService
from app.engineering.sets.store import SetStore
from app.engineering.swap.rules import PROVEN, STEPS, ProbeFinding, SwapState, advice, done_steps
from app.engineering.swap.service import MAX_PROBES, Swap, SwapService, SwapSource, SwapStore, step_text
from app.errors import Problem
from app.line.live.bus_live import LiveState
from bus.contract import Action, FoundUnit, Outcome, Reading, Result, ScanBus, UnitLink, UnitLinkState
from bus.instants import UnixTime
from bus.messages import Message, term
from bus.settings import BusSettings
from tests.app.complete_app import House
from tests.app.played_commands import ANNA, Noted, a_bus
from tests.app.played_line import BUS, played_line
from tests.for_each import for_each


def state(at_target: ProbeFinding, at_factory: ProbeFinding = "silent", **more: object) -> SwapState:
    given = {"remote": None, "equal": None, "configured": frozenset({5})} | more
    return SwapState(5, at_target, at_factory, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("seen", "step", "at_keypad", "code"),
    [
        (state("silent"), "find", True, "swap_nothing_new"),
        (state("silent", "digimax"), "address", True, "swap_at_factory"),
        (state("silent", "digimax", configured=frozenset({1, 5})), "find", True, "swap_nothing_new"),
        (state("silent", "garbled"), "address", True, "swap_two_at_factory"),
        (state("garbled"), "address", True, "swap_two_units"),
        (state("foreign"), "address", True, "swap_foreign"),
        (state("late"), "find", False, "swap_late"),
        (state("digimax", remote=None), "remote", True, "swap_set_remote"),
        (state("digimax", remote=False), "remote", True, "swap_set_remote"),
        (state("digimax", remote=True), "restore", False, "swap_restore_now"),
        (state("digimax", remote=True, equal=False), "restore", False, "swap_restore_now"),
        (state("digimax", remote=True, equal=True), "proven", False, "swap_proven"),
    ],
)
def test_what_to_do_now(seen: SwapState, step: str, at_keypad: bool, code: str) -> None:
    now = advice(seen)
    assert (now.step, now.at_keypad, now.text.code) == (step, at_keypad, code)
    assert "{" not in str(now.text)


def test_the_old_unit_is_not_taken_for_the_spare() -> None:
    now = advice(state("digimax", remote=True, is_new=False))
    assert (now.step, now.confirms_spare) == ("find", True)
    assert now.text == Message.of("swap_old_or_new", target=5)


@for_each("link, lost_at, holds", [("online", 9.0, True), ("stale", 4.0, True), ("offline", 6.0, False)])
def test_a_unit_that_was_found_and_lost_since_is_not_shown(
    link: UnitLinkState, lost_at: float, holds: bool
) -> None:
    """A silent address takes long to read again, and meanwhile the page would go on about the unit."""
    found, now = state("digimax", read_at=UnixTime(5.0)), UnitLink(5, UnixTime(lost_at), link)
    assert found.still_holds(now) == holds
    assert state("silent").still_holds(now)


def test_another_baud_than_that_of_the_box_is_named() -> None:
    text = advice(state("silent", baud=4800)).text
    assert text == Message.of("swap_nothing_new_other_baud", target=5, baud=4800, hundreds=48)


@dataclass
class Wire:
    """A command service whose scans return, after ``before``, one of ``seen`` after the other."""

    seen: list[ProbeFinding] = field(default_factory=list)
    outcome: Outcome = "verified"
    before: Callable[[], Awaitable[object]] | None = None

    async def send(self, _who: Person, action: Action, **_: Any) -> Result:
        assert isinstance(action, ScanBus)
        if self.before is not None:
            await self.before()
        kind = self.seen.pop(0)
        found = [] if kind == "silent" else [FoundUnit(action.first, 9600, kind)]
        return Result(id="x", at=1.0, outcome=self.outcome, message=term("no link"), found=found)


class Scene:
    """A swap service on a store that holds one set of unit 2."""

    def __init__(self, folder: Path) -> None:
        self.events = Noted()
        self.database = Database(folder / "store.db")
        self.store = SwapStore(self.database)
        self.restores: dict[str, Restore] = {}
        self.live, self.wire = a_bus(), Wire()
        self.swaps = self.another()

    def another(self) -> SwapService:
        """Return the swap service of a server that was restarted."""
        commands = {"dry-end": self.wire}
        return SwapService(self.live, commands, {}, self, self.store, self.events)  # type: ignore[arg-type]

    async def find(self, restore_id: str) -> Restore | None:
        """Find a restore, as the restore service does."""
        return self.restores.get(restore_id)

    def on_end(self, _subscriber: EndSubscriber) -> None:
        """Do nothing: the test itself reports the end of a restore."""

    async def look(self, swap: Swap, *seen: ProbeFinding) -> SwapState | None:
        """Look at the wire, whose next probes find ``seen``."""
        self.wire.seen = list(seen)
        return await self.swaps.look(ANNA, swap)

    async def begin(self) -> Swap:
        kept = await SetStore(self.database).save(
            ParameterSet("dry-end", 1.0, "anna", "by hand", (UnitRows(2, "Nip", {}),))
        )
        return await self.swaps.begin(ANNA, "dry-end", 2, SwapSource(kept.id, 2))


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    made = Scene(tmp_path)
    yield made
    made.database.close()


async def test_a_swap_ends_with_one_complete_event(scene: Scene) -> None:
    swap, events = await scene.begin(), scene.events
    for seen in (
        state("digimax"),
        state("silent", "garbled"),
        state("silent"),
        state("digimax", remote=True),
    ):
        swap.saw(seen)
    assert swap.is_new
    restore = a_restore(state="different")
    await scene.swaps.on_restore_end(restore)
    assert swap.equal is False
    assert len(events.events) == 1
    restore.state = "equal"
    await scene.swaps.on_restore_end(restore)
    await scene.swaps.on_restore_end(restore)
    assert swap.proven
    [_, end] = events.events
    assert (end["what"], end["outcome"], end["unit"]) == ("unit replaced and verified", "verified", 2)
    for part in (
        "no response at address 5 and two units respond at address 1",
        "from set 1:",
        "done: Acceleration Ramp Rate (parameter 6)",
        "Unit ID Number (parameter 17): the address is set at the keypad only",
        "verified by a full read",
    ):
        assert part in end["message"]


async def test_a_restore_from_before_the_swap_verifies_nothing_about_it(scene: Scene) -> None:
    swap = await scene.begin()
    await scene.swaps.on_restore_end(a_restore(state="equal", planned_at=99.0))
    assert (swap.restore, swap.proven) == (None, False)


async def test_another_restore_of_the_unit_verifies_nothing_about_the_swap(scene: Scene) -> None:
    swap = await scene.begin()
    await scene.swaps.on_restore_end(a_restore(state="equal", for_swap=False))
    assert (swap.restore, swap.proven) == (None, False)
    assert len(scene.events.events) == 1


def test_what_the_spare_was_not_given_is_named_with_the_result() -> None:
    swap, restore = Swap("dry-end", 2, "anna", SwapSource(1, 2), UnixTime(100.0)), a_restore(state="equal")
    restore.wanted = UnitRows(2, "Nip", {number: ParameterRow(number, 5) for number in (6, 7, 17)})
    swap.restore, swap.proven = restore, True
    assert step_text(PROVEN, swap) == Message("swap_proven")
    left = LeftOut(7, "deselected", Message("row_deselected"))
    restore.plan = replace(restore.plan, left_out=(*restore.left_out, left))
    assert str(step_text(PROVEN, swap)) == (
        "The new unit has the parameters of the old unit, verified by a full read, except what was not"
        " written: Deceleration Ramp Rate (parameter 7). The report states why."
    )


async def test_of_two_who_begin_at_once_one_is_refused(scene: Scene) -> None:
    begun = await asyncio.gather(scene.begin(), scene.begin(), return_exceptions=True)
    assert [type(each) for each in begun] == [Swap, Problem]
    assert scene.swaps.find("dry-end", 2) is begun[0]
    assert len(scene.events.events) == 1


async def test_a_closed_swap_stays_closed_while_its_unit_is_read(scene: Scene) -> None:
    """Another person cancels it, and perhaps begins another, while the requests of the first still read."""
    swap = await scene.begin()

    scene.wire.before = partial(scene.swaps.cancel, ANNA, swap)
    await scene.look(swap, "digimax")
    kept = ParameterSet("dry-end", 1.0, "anna", "by hand", (), id=9)
    for step in (
        scene.swaps.begin_restore(ANNA, swap, a_restore(state="planned")),
        scene.swaps.confirm_spare(ANNA, swap),
        scene.swaps.save_entered(ANNA, swap, kept),
        scene.swaps.cancel(ANNA, swap),
    ):
        with pytest.raises(Problem, match="no replacement of unit 2") as refused:
            await step
        assert refused.value.status == 404
    later = scene.another()
    await later.load()
    assert (later.find("dry-end", 2), swap.proven) == (None, False)
    assert [event["what"] for event in scene.events.events][-1] == "unit replacement canceled"


async def test_a_server_that_ends_forgets_no_swap(scene: Scene) -> None:
    swap, restore = await scene.begin(), a_restore(state="different")
    await scene.look(swap, "silent", "silent")
    await scene.look(swap, "digimax")
    await scene.swaps.on_restore_end(restore)

    scene.restores[restore.id] = restore
    again = scene.another()
    await again.load()
    known = again.find_or_404("dry-end", 2)
    assert (known.who, known.began_at, known.source) == ("anna", swap.began_at, SwapSource(1, 2))
    assert (known.is_new, known.seen, known.equal, known.proven) == (True, swap.seen, False, False)
    with pytest.raises(Problem, match="anna has already started a replacement of unit 2"):
        await again.begin(ANNA, "dry-end", 2, None)
    await again.cancel(ANNA, known)
    later = scene.another()
    await later.load()
    assert later.find("dry-end", 2) is None


async def test_without_a_set_the_sheet_is_entered_and_the_unit_kept(scene: Scene) -> None:
    swap = await scene.swaps.begin(ANNA, "dry-end", 2, None)
    assert scene.events.events[-1]["what"] == "unit replacement started, from the parameter sheet"
    ready = advice(state("digimax", remote=True))
    assert step_text(ready, swap) == Message("swap_enter_sheet")
    await scene.swaps.save_entered(ANNA, swap, ParameterSet("dry-end", 1.0, "anna", "by hand", (), id=9))
    assert swap.equal
    proven = advice(state("digimax", remote=True, equal=True))
    assert step_text(proven, swap) == Message("swap_compare_with_sheet")
    assert "saved as set 9" in scene.events.events[-1]["message"]


def test_a_unit_without_a_set_is_offered_those_of_its_group_first() -> None:
    settings = BusSettings.model_validate(
        {
            "name": "dry-end",
            "port": "/dev/null",
            "unit": [
                {"id": 1, "name": "Unwind", "group": "winder"},
                {"id": 2, "name": "Nip", "group": "press"},
                {"id": 3, "name": "Coater", "group": "press"},
            ],
        }
    )
    live = LiveState([settings], started_at=0.0)
    sets = [
        ParameterSetSummary(number, "dry-end", "", "", float(number), "anna", "by hand", golden, units)
        for number, units, golden in ((4, (1, 2), ()), (3, (2,), ()), (2, (2,), (2,)))
    ]
    helps = offers(live, sets, "dry-end", 3)
    assert (helps.own, helps.best) == ([], "")
    assert [one.text for one in helps.sisters] == ["set:4:2", "set:2:2", "set:4:1"]
    assert [one.text for one in helps.neighbours] == ["live:dry-end:2", "live:dry-end:1"]
    assert offers(live, sets, "dry-end", 2).best == "set:2:2"


@pytest.mark.parametrize(
    ("link", "seen", "at_target"),
    [
        ("online", ["silent", "digimax"], "digimax"),
        ("online", ["silent", "silent", "garbled"], "garbled"),
        ("online", ["silent"] * MAX_PROBES + ["silent"], "silent"),
        ("offline", ["silent", "silent"], "silent"),
    ],
)
async def test_one_lost_response_of_an_online_unit_is_no_loss(
    scene: Scene, link: Literal["online", "offline"], seen: list[ProbeFinding], at_target: ProbeFinding
) -> None:
    swap = await scene.begin()
    scene.live.buses["dry-end"].apply([UnitLink(unit=2, at=101.0, link=link)])
    shown = await scene.look(swap, *seen)
    assert shown is not None
    assert (shown.at_target, scene.wire.seen) == (at_target, [])


@pytest.mark.parametrize(
    ("heard_at", "lost", "named"), [(1.0, True, True), (-1.0, True, False), (1.0, False, False)]
)
async def test_a_spare_that_may_have_the_address_of_another_unit(
    scene: Scene, heard_at: float, lost: bool, named: bool
) -> None:
    """Unit 1, lost since the swap of unit 2 began, is named; one that was lost before is not."""
    swap = await scene.begin()
    at = swap.began_at + heard_at
    scene.live.buses["dry-end"].apply([Reading(1, at, 0, 0, 0, 0, 0)])
    scene.live.buses["dry-end"].apply([UnitLink(1, at, "offline" if lost else "online")])
    shown = await scene.look(swap, "silent", "silent")
    assert shown is not None
    assert advice(shown).other_lost == ((1, at) if named else None)


async def test_a_look_that_came_to_no_end_shows_nothing(scene: Scene) -> None:
    swap = await scene.begin()
    scene.wire.outcome = "unverified"
    with pytest.raises(Problem, match="no link"):
        await scene.look(swap, "silent")
    assert not swap.is_new


def a_restore(state: RestoreState, planned_at: float = 1e12, *, for_swap: bool = True) -> Restore:
    write = Write(6, present=100, wanted=50)
    plan = RestorePlan((write,), (LeftOut(17, "address", Message("row_address")),), equal=38)
    empty = UnitRows(2, "Nip", {})
    rows = [RowResult(write, "verified")]
    return Restore("r", "dry-end", 2, "anna", empty, empty, plan, rows, planned_at, state, for_swap=for_swap)


def test_all_steps_are_done_only_when_it_is_verified() -> None:
    assert tuple(done_steps("proven")) == STEPS
    assert list(done_steps("remote")) == ["find", "address"]


async def test_repeated_page_requests_do_not_pile_up_scans(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.engineering.swap.service.PROBE_WAIT_S", 0.01)
    swap, responds = await scene.begin(), asyncio.Event()
    scene.wire.before, scene.wire.seen = responds.wait, ["digimax"]
    assert [await scene.swaps.look(ANNA, swap) for _ in range(3)] == [None] * 3
    responds.set()
    shown = await scene.swaps.look(ANNA, swap)
    assert shown is not None
    assert (shown.at_target, scene.wire.seen) == ("digimax", [])


SWAP = f"/swap/{BUS}/2"


@pytest.fixture
async def house(house: House) -> House:
    await played_line(house.services)
    return house


async def stored(client: httpx.AsyncClient) -> int:
    return int((await client.post(f"/api/v1/buses/{BUS}/sets", json={"units": [2]})).json()["id"])


async def test_a_stored_set(house: House, client: httpx.AsyncClient) -> None:
    number = await stored(client)
    begun = await client.post(SWAP, data={"source": f"set:{number}:2"})
    assert (begun.status_code, begun.headers["location"]) == (303, SWAP)
    swap = house.services[SwapService].find_or_404(BUS, 2)
    assert swap.source is not None
    assert swap.source.set == number


async def test_a_file_replaces_the_selection(house: House, client: httpx.AsyncClient) -> None:
    number = await stored(client)
    document = (await client.get(f"/api/v1/sets/{number}/document")).content
    data = {"source": f"set:{number}:2"}
    begun = await client.post(SWAP, data=data, files={"file": ("nip.toml", document)})
    assert begun.status_code == 303
    source = house.services[SwapService].find_or_404(BUS, 2).source
    assert source is not None
    kept = await house.services[SetStore].load(source.set)
    assert kept is not None
    assert (kept.id > number, kept.name, kept.origin) == (True, "nip.toml", "from a file")


async def test_the_sheet(house: House, client: httpx.AsyncClient) -> None:
    # As a browser does: the field of a file that was not chosen is sent, empty.
    begun = await client.post(SWAP, data={"source": "sheet"}, files={"file": ("", b"")})
    assert begun.status_code == 303
    assert house.services[SwapService].find_or_404(BUS, 2).source is None


@for_each("source", ["set:99:2", "nonsense"])
async def test_what_names_no_source_begins_nothing(
    house: House, client: httpx.AsyncClient, source: str
) -> None:
    refused = await client.post(SWAP, data={"source": source})
    assert refused.status_code in (404, 422)
    assert house.services[SwapService].find(BUS, 2) is None


async def test_a_form_without_a_source_says_so_at_its_field(house: House, client: httpx.AsyncClient) -> None:
    refused = await client.post(SWAP, data={"source": ""})
    assert (refused.status_code, 'id="source-error">choose the source' in refused.text) == (422, True)
    assert house.services[SwapService].find(BUS, 2) is None


async def test_the_restore_of_a_spare_leads_back_to_the_swap_and_no_other_does(
    house: House, client: httpx.AsyncClient
) -> None:
    number = await stored(client)
    await client.post(SWAP, data={"source": f"set:{number}:2"})
    planned = await client.post(f"{SWAP}/restore")
    again = await client.post(f"{planned.headers['location']}/again")
    other = await client.post(f"/units/{BUS}/2/restore", data={"source": f"set:{number}:2"})
    links = []
    for review in (planned, again, other):
        path = review.headers["location"]
        # There is nothing to write: a spare is verified all the same.
        assert ("Verify the spare" in (await client.get(path)).text) is (review is not other)
        started = await client.post(f"{path}/start")
        assert started.status_code == (422 if review is other else 303)
        if review is other:
            assert (await client.post(f"/api/v1{path}/start")).status_code == 202
        await house.services[RestoreService].background.settled()
        links.append(f'href="{SWAP}"' in (await client.get(path)).text)
    assert links == [True, True, False]
    assert house.services[SwapService].find_or_404(BUS, 2).proven


async def test_a_spare_with_a_set_is_not_called_verified_by_the_sheet(
    house: House, client: httpx.AsyncClient
) -> None:
    await client.post(SWAP, data={"source": f"set:{await stored(client)}:2"})
    refused = await client.post(f"{SWAP}/entered", headers={"accept": "application/json"})
    assert (refused.status_code, refused.json()["code"]) == (409, "not_in_state")
    assert not house.services[SwapService].find_or_404(BUS, 2).proven
