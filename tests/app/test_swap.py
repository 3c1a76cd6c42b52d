"""The swap path: from what the wire shows to what a person has to do."""

from __future__ import annotations

import asyncio

import pytest

from app.sets.model import UnitRows
from app.sets.plan import LeftOut, RestorePlan, Write
from app.sets.restore_record import Restore, RowResult, State
from app.swap.desk import SwapDesk, latest
from app.swap.rules import STEPS, Kind, Sight, advice, done_steps
from tests.app.played_desk import ANNA, Noted


def sight(at_target: Kind, at_factory: Kind = "silent", **more: object) -> Sight:
    given = {"remote": None, "equal": None, "configured": frozenset({5})} | more
    return Sight(5, at_target, at_factory, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("seen", "step", "at_panel", "says"),
    [
        (sight("silent"), "find", True, "Connect and power"),
        (sight("silent", "digimax"), "address", True, "factory address"),
        (sight("silent", "digimax", configured=frozenset({1, 5})), "find", True, "Connect and power"),
        (sight("silent", "garbled"), "address", True, "Two units answer at address {factory}"),
        (sight("garbled"), "address", True, "Two units answer at address {target}"),
        (sight("foreign"), "address", True, "no DIGIMAX IV"),
        (sight("digimax", remote=None), "remote", True, "REMOTE"),
        (sight("digimax", remote=False), "remote", True, "REMOTE"),
        (sight("digimax", remote=True), "restore", False, "Restore"),
        (sight("digimax", remote=True, equal=False), "restore", False, "Restore"),
        (sight("digimax", remote=True, equal=True), "proven", False, "proven"),
    ],
)
def test_what_to_do_now(seen: Sight, step: str, at_panel: bool, says: str) -> None:
    now = advice(seen)
    assert (now.step, now.at_panel) == (step, at_panel)
    assert says in now.text
    assert now.text.format(target=5, factory=1, baud=9600, hundreds=96)


def test_the_old_unit_is_not_taken_for_the_spare() -> None:
    now = advice(sight("digimax", remote=True, is_new=False))
    assert (now.step, now.asks) == ("find", True)
    assert "the old one" in now.text


def test_another_baud_than_that_of_the_box_is_named() -> None:
    assert "Out of its box it speaks at 9600 baud" in advice(sight("silent", baud=4800)).text


async def test_a_swap_ends_with_one_event_that_tells_all_of_it() -> None:
    events = Noted()
    desk = SwapDesk(events, lambda: 100.0)  # type: ignore[arg-type]
    swap = await desk.begin(ANNA, "dry-end", 2, source=7)
    for seen in (
        sight("digimax"),
        sight("silent", "garbled"),
        sight("silent"),
        sight("digimax", remote=True),
    ):
        swap.saw(seen)
    assert swap.is_new
    restore = a_restore(state="different")
    await desk.ended(restore)
    assert swap.equal is False
    assert len(events.events) == 1
    restore.state = "equal"
    await desk.ended(restore)
    await desk.ended(restore)
    assert swap.proven
    [_, end] = events.events
    assert (end["what"], end["outcome"], end["unit"]) == ("unit swapped and proven", "verified", 2)
    for part in (
        "two units answer at 1",
        "from set 7",
        "done: #6",
        "#17: at the keypad",
        "proven by a full read",
    ):
        assert part in end["message"]


async def test_a_restore_from_before_the_swap_proves_nothing_about_it() -> None:
    desk = SwapDesk(Noted(), lambda: 100.0)  # type: ignore[arg-type]
    swap = await desk.begin(ANNA, "dry-end", 2, source=7)
    await desk.ended(a_restore(state="equal", planned_at=99.0))
    assert (swap.restore, swap.proven) == (None, False)


def a_restore(state: State, planned_at: float = 101.0) -> Restore:
    write = Write(6, present=100, wanted=50)
    plan = RestorePlan((write,), (LeftOut(17, "at the keypad"),), equal=38)
    empty = UnitRows(2, "Nip", {})
    rows = [RowResult(write, "verified")]
    return Restore("r", "dry-end", 2, "anna", empty, empty, plan, rows, planned_at, state)


def test_all_steps_lie_behind_only_when_it_is_proven() -> None:
    assert tuple(done_steps("proven")) == STEPS
    assert list(done_steps("remote")) == ["find", "address"]


async def test_a_page_that_asks_again_does_not_pile_up_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.swap.desk.LOOK_WAIT_S", 0.01)
    swap = await SwapDesk(Noted(), lambda: 100.0).begin(ANNA, "dry-end", 5, source=7)  # type: ignore[arg-type]
    begun, seen = [], asyncio.Event()

    async def look() -> Sight:
        begun.append(1)
        await seen.wait()
        return sight("silent")

    assert [await latest(swap, look) for _ in range(3)] == [None] * 3
    assert len(begun) == 1
    seen.set()
    assert (await latest(swap, look)) == sight("silent", equal=None)
    assert swap.is_new
