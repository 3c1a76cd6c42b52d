"""What open pages are sent, how often, and how many of them there may be."""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pytest

from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.templating import Templates
from app.line.live.browser import MAX_FRAMES, Browser, Diff
from app.line.live.bus_live import LiveState
from app.line.live.hub import FEW_PAGES, FLOOD, MAX_SENDS_S, WINDOW_S, Broadcast, Flow, Hub, Watched
from app.line.live.requests import (
    MAX_PAGES_OF_ACCOUNT,
    MAX_PAGES_OF_ADDRESS,
    Admission,
    key_of,
    new_command_id,
)
from app.line.live.screen import FEW_MOVING, Screen
from app.settings import Site
from bus.contract import BusFigures, Frame, Frames, Progress, UnitFigures, UnitLink
from bus.messages import term
from tests.app.played_sources import played_sources
from tests.app.screens import HEALTHY, REMOTE, line, reading, screen


def flow() -> tuple[Flow, list[float]]:
    now = [100.0]
    return Flow(lambda: now[0]), now


def test_what_one_wire_brings_is_never_held_up() -> None:
    made, now = flow()
    for _ in range(200):
        now[0] += 1 / 38.4
        made.came()
        assert made.pause_s() == 0.0


def test_a_flood_is_sent_once_per_window_until_it_is_over() -> None:
    made, now = flow()
    made.came(FLOOD + 1)
    assert made.pause_s() == 0.0, "a burst is sent at once"
    made.sent()
    assert made.pause_s() == WINDOW_S, "and what follows it later"
    now[0] += WINDOW_S
    made.came()
    made.sent()
    assert made.pause_s() == WINDOW_S, "the next window begins flooded"
    now[0] += WINDOW_S
    made.came()
    made.sent()
    assert made.pause_s() == 0.0, "that window was quiet"


def test_very_many_pages_share_what_the_server_can_send() -> None:
    made, now = flow()
    made.share(200)
    made.came()
    assert made.pause_s() == 0.0, "the first is sent at once"
    made.sent()
    made.came()
    assert made.pause_s() == pytest.approx(200 / MAX_SENDS_S)
    now[0] += 1.01 * 200 / MAX_SENDS_S
    assert made.pause_s() == 0.0


def test_a_few_pages_get_every_response() -> None:
    made, _now = flow()
    made.share(200)
    made.share(FEW_PAGES)
    made.sent()
    made.came()
    assert made.pause_s() == 0.0


GROUP = "dry/1"


def broadcast(paced: Flow | None = None) -> Broadcast:
    return Broadcast(screen(line()), lambda: 100.0, flow=paced or Flow())


async def sent_by(browser: Browser) -> list[dict[str, Any]]:
    return [json.loads(text) for text in await browser.next()]


def joined(made: Broadcast) -> Browser:
    browser = Browser("anna", "operator", "en")
    made.join(browser)
    return browser


async def test_a_snapshot_states_what_a_page_is_rendered_with() -> None:
    made = Broadcast(screen(line()), lambda: 100.0, "3f9a")
    (snapshot,) = await sent_by(joined(made))
    assert snapshot["digest"] == "3f9a"


async def test_few_pages_are_updated_at_once() -> None:
    made = broadcast()
    browser = joined(made)
    made.publish({GROUP: {"commanded": "1"}})
    made.publish({GROUP: {"commanded": "2"}})
    assert made.number == 2
    snapshot, diff = await sent_by(browser)
    assert (snapshot["n"], diff["p"], diff["n"], diff["f"]) == (0, 0, 2, {GROUP: {"commanded": "2"}})


async def test_what_a_unit_at_speed_measures_waits_for_any_other_change() -> None:
    made = broadcast(flow()[0])
    browser = joined(made)
    made.publish({GROUP: {"actual": "1", "at": "1"}})
    await sent_by(browser)
    made.publish({GROUP: {"actual": "2", "at": "2"}})
    assert made.number == 1
    made.publish({GROUP: {"state": "ramping_up"}})
    (diff,) = await sent_by(browser)
    assert (diff["n"], diff["f"]) == (2, {GROUP: {"actual": "2", "at": "2", "state": "ramping_up"}})


def test_what_moving_units_measure_goes_at_once_unless_many_move() -> None:
    live = line(FEW_MOVING + 2)
    shown = screen(live)

    def may_wait(unit: int, **values: int) -> bool:
        live.buses["dry"].apply([reading(unit, at=100.1, **values)])
        shown.render("dry", [unit], 100.1, include_bus=False)
        return shown.may_wait({f"dry/{unit}": {"actual": "1"}})

    ramps: dict[str, int] = {"actual": 1000, "outputs": REMOTE}
    assert may_wait(FEW_MOVING + 2, actual=0, outputs=REMOTE, inputs=HEALTHY), "one that stands still"
    assert not any(may_wait(unit, **ramps) for unit in range(1, FEW_MOVING + 1))
    assert may_wait(FEW_MOVING + 1, **ramps)
    assert not shown.may_wait({GROUP: {"actual": "1", "state": "at_speed"}}), "a state never waits"
    live.buses["dry"].apply([UnitLink(unit=2, at=100.1, link="offline")])
    shown.render("dry", [2], 100.1, include_bus=False)
    assert not may_wait(1, **ramps), "few are left online"
    assert may_wait(1), "one that has arrived"


async def test_among_very_many_delayed_changes_go_as_one() -> None:
    made = broadcast(flow()[0])
    made.flow.share(FEW_PAGES + 1)
    browser = joined(made)
    made.publish({GROUP: {"actual": "1"}})
    await sent_by(browser)
    made.publish({GROUP: {"actual": "2", "mode": "local"}})
    made.publish({GROUP: {"actual": "3"}})
    assert made.number == 1
    async with asyncio.timeout(30):
        (diff,) = await sent_by(browser)
    assert (diff["p"], diff["n"], diff["f"]) == (1, 2, {GROUP: {"actual": "3", "mode": "local"}})


async def test_a_page_that_opens_meanwhile_misses_no_number() -> None:
    made = broadcast(flow()[0])
    made.flow.share(FEW_PAGES + 1)
    joined(made)
    made.publish({GROUP: {"actual": "1"}})
    made.publish({GROUP: {"actual": "2"}})
    late = joined(made)
    ((snapshot,), (diff,)) = (await sent_by(late), await sent_by(late))
    assert (snapshot["n"], diff["p"]) == (1, 1)


async def test_nothing_is_kept_without_pages() -> None:
    made = broadcast(flow()[0])
    made.flow.share(FEW_PAGES + 1)
    browser = joined(made)
    made.publish({GROUP: {"actual": "1"}})
    made.publish({GROUP: {"actual": "2"}})
    made.leave(browser)
    made.publish({GROUP: {"actual": "3"}}, always=True)
    assert made.number == 1
    await sent_by(joined(made))
    made.flow.share(1)
    made.publish({}, always=True)
    assert made.number == 2


@pytest.mark.parametrize(("always", "number"), [(False, 0), (True, 1)])
async def test_without_changes_only_a_heartbeat_is_sent(always: bool, number: int) -> None:
    made = broadcast(flow()[0])
    joined(made)
    made.publish({}, always=always)
    assert made.number == number


async def test_no_reader_is_always_the_last() -> None:
    made, order = broadcast(), list[str]()

    class Noting(Browser):
        def send_diff(self, diff: Diff) -> None:
            order.append(self.name)
            super().send_diff(diff)

    for name in "abc":
        made.join(Noting(name, "operator", "en"))
    for n in range(3):
        made.publish({GROUP: {"commanded": str(n)}})
    assert {order[n : n + 3][-1] for n in (0, 3, 6)} == {"a", "b", "c"}


@dataclass
class World:
    live: LiveState = field(default_factory=line)
    now: float = 100.0
    watched: list[tuple[str, list[int], bool]] = field(default_factory=list)
    controls: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        templates = Templates(templates_dir(), Assets(static_dir()), Site())
        self.sources = played_sources(self.live.buses, controls=self.controls)
        self.hub = Hub(self.live, self.sources, templates, lambda: self.now)
        self.hub.watchers |= {bus: partial(self.watch, bus) for bus in self.live.buses}

    def watch(self, bus: str, units: list[int], trace: bool) -> None:
        self.watched.append((bus, units, trace))

    def join(self, name: str = "anna", language: str = "en") -> Browser:
        browser = Browser(name, "operator", language)
        self.hub.join(browser)
        return browser


@pytest.fixture
def world() -> World:
    return World()


async def sent(browser: Browser) -> list[dict[str, Any]]:
    return [json.loads(text) for text in await browser.next()]


async def test_a_snapshot_comes_first_then_changes(world: World) -> None:
    browser = world.join()
    first, _people = await sent(browser)
    assert first["is"] == "snapshot"
    assert first["f"]["dry/1"]["actual"] == "120.0"
    world.live.buses["dry"].apply([reading(1, at=100.1, actual=1210)])
    (diff,) = await sent(browser)
    assert diff["f"]["dry/1"]["actual"] == "121.0"
    assert "dry/2" not in diff["f"]
    assert diff["p"] == _people["n"]


async def test_the_same_text_goes_to_all_of_a_language(world: World) -> None:
    one, other = world.join("anna"), world.join("bernd")
    await sent(one)
    await sent(other)
    world.live.buses["dry"].apply([reading(1, at=100.1, actual=1210)])
    (first,), (second,) = await one.next(), await other.next()
    assert first is second


async def test_a_page_that_opens_beside_another_renders_nothing_again(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    await sent(world.join("anna"))
    world.live.buses["dry"].apply([reading(1, at=100.1, actual=1210)])
    monkeypatch.delattr(Screen, "refresh")
    first, *_ = await sent(world.join("bernd"))
    assert first["f"]["dry/1"]["actual"] == "121.0"


async def test_a_page_that_opens_alone_shows_what_was_reported_while_none_was_open(world: World) -> None:
    world.hub.leave(world.join("anna"))
    world.live.buses["dry"].apply([reading(1, at=100.1, actual=1210)])
    first, *_ = await sent(world.join("bernd"))
    assert first["f"]["dry/1"]["actual"] == "121.0"


async def test_a_missing_reading_shows_with_the_heartbeat(world: World) -> None:
    browser = world.join()
    await sent(browser)
    world.now = 103.0
    world.hub.tick()
    (beat,) = await sent(browser)
    assert beat["f"]["dry/1"]["link"] == "stale"


async def test_each_user_is_listed_once(world: World) -> None:
    one = world.join("anna")
    world.join("anna")
    other = world.join("bernd")
    await sent(one)
    assert world.hub.connected == 3
    world.hub.leave(other)
    (diff,) = await sent(one)
    assert diff["f"]["people"] == {"here": [["anna", "operator"]], "count": "1"}


async def test_how_far_a_command_is_goes_to_the_pages_and_is_not_kept(world: World) -> None:
    browser = world.join("bernd", "de")
    await sent(browser)
    world.live.buses["dry"].apply([Progress(id="x1", at=100.1, stage="sent")])
    (diff,) = await sent(browser)
    assert diff["f"] == {"command/x1": {"stage": "gesendet"}}
    assert "command/x1" not in world.hub.screen("de").shown


async def test_a_page_finds_its_command_by_the_key_that_it_gave(world: World) -> None:
    browser = world.join("bernd", "de")
    await sent(browser)
    command_id = new_command_id("form#7")
    assert command_id != new_command_id("form#7")
    world.live.buses["dry"].apply([Progress(id=command_id, at=100.1, stage="sent")])
    (diff,) = await sent(browser)
    assert diff["f"] == {"command/form#7": {"stage": "gesendet"}}
    unnamed = new_command_id()
    assert key_of(unnamed) == unnamed


async def test_scan_progress_goes_to_pages_of_the_bus(world: World) -> None:
    browser = world.join("bernd", "de")
    await sent(browser)
    world.live.buses["dry"].apply([Progress(id="x1", at=100.1, stage="searching", done=17, of=255)])
    (diff,) = await sent(browser)
    assert diff["f"] == {"dry": {"searched": "abgesuchte Adressen: 17/255"}}
    for at, done, left in ((120.1, 37, "4 min"), (335.1, 252, "4 s")):
        world.live.buses["dry"].apply([Progress(id="x1", at=at, stage="searching", done=done, of=255)])
        (diff,) = await sent(browser)
        assert diff["f"] == {"dry": {"searched": f"abgesuchte Adressen: {done}/255 · noch etwa {left}"}}
    assert "searched" not in world.hub.screen("de").shown["dry"]


async def test_frames_go_only_to_who_follows(world: World) -> None:
    follower, other = world.join("anna"), world.join("bernd")
    await sent(follower)
    await sent(other)
    world.hub.follow(follower, (), "dry")
    frame = Frame(at=100.1, direction="out", data=b"\x10\x02", meanings=[term("a beginning")])
    world.live.buses["dry"].apply([Frames(frames=[frame])])
    (shown,) = await sent(follower)
    assert shown["frames"][0]["hex"] == "10 02"
    world.hub.tick()
    assert [message["is"] for message in await sent(other)] == ["diff"]


async def test_the_worker_gets_the_watched_units_until_there_are_none(world: World) -> None:
    browser = world.join()
    world.hub.follow(browser, ("dry/2", "elsewhere/1"), "")
    world.hub.follow(browser, ("dry/2",), "")
    world.hub.leave(browser)
    assert world.watched == [("dry", [1, 2], False), ("dry", [2], False), ("dry", [], False)]


async def test_the_health_of_a_unit_goes_to_its_page_only(world: World) -> None:
    browser = world.join()
    world.hub.follow(browser, ("dry/2",), "")
    await sent(browser)
    units = [UnitFigures(unit=n, polls=5, responses=5) for n in (1, 2)]
    world.live.buses["dry"].apply(
        [
            BusFigures(
                at=100.1, scan_hz=4, scan_s=0.2, wire_utilisation=0.9, scan_s_with_one_more=0.3, units=units
            )
        ]
    )
    (diff,) = await sent(browser)
    assert diff["f"]["health/dry/2"]["responses"] == "5"
    assert "health/dry/1" not in diff["f"]


async def test_who_holds_control_is_on_every_page(world: World) -> None:
    world.controls["dry"] = "anna"
    browser = world.join()
    snapshot = (await sent(browser))[0]
    assert snapshot["f"]["line_summary"]["holder"] == "anna"
    world.controls["dry"] = "ben"
    world.hub.tick()
    changed = (await sent(browser))[-1]["f"]
    assert (changed["line_summary"]["holder"], changed["dry"]["held_by"]) == ("ben", "ben")


def test_an_account_has_so_many_pages_and_another_has_its_own() -> None:
    admission = Admission()
    assert all(admission.enter("ann", f"a{n}") for n in range(MAX_PAGES_OF_ACCOUNT))
    assert not admission.enter("ann", "b")
    assert admission.enter("ben", "b")
    admission.leave("ann", "a0")
    assert admission.enter("ann", "b")


def test_an_address_has_so_many_pages() -> None:
    admission = Admission()
    assert all(admission.enter(f"p{n}", "a") for n in range(MAX_PAGES_OF_ADDRESS))
    assert not admission.enter("ann", "a")
    assert admission.enter("ann", "b")


def test_nothing_is_kept_of_who_has_gone() -> None:
    admission = Admission()
    admission.enter("ann", "a")
    admission.leave("ann", "a")
    assert not admission._by_account
    assert not admission._by_address


def test_what_any_page_shows_is_watched() -> None:
    watched = Watched({"dry": [1, 2, 3]})
    shown = watched.known(("dry/1", "dry/2", "dry/99", "wet/1", "dry/²", "dry"))
    assert shown == {("dry", 1), ("dry", 2)}
    watched.turn(frozenset(), shown, "", "dry")
    watched.turn(frozenset(), frozenset({("dry", 2)}), "", "")
    assert (watched.units("dry"), watched.is_traced("dry")) == ([1, 2], True)
    watched.turn(shown, frozenset({("dry", 3)}), "dry", "")
    assert (watched.units("dry"), watched.is_traced("dry")) == ([2, 3], False)


def diff(n: int, **fields: str) -> Diff:
    return Diff(n - 1, n, 100.0 + n, {"dry/1": fields} if fields else {})


async def test_a_diff_is_sent_as_it_was_encoded_for_all() -> None:
    browser = Browser("anna", "operator", "en")
    one = diff(1, actual="1")
    browser.send_diff(one)
    assert await browser.next() == [one.text]
    assert json.loads(one.text) == {"is": "diff", "p": 0, "n": 1, "t": 101.0, "f": {"dry/1": {"actual": "1"}}}


async def test_newest_wins_for_a_slow_browser_and_nothing_is_queued() -> None:
    browser = Browser("anna", "operator", "en")
    for n in range(1, 1001):
        browser.send_diff(diff(n, actual=str(n)))
    browser.send_diff(diff(1001, mode="local"))
    (only,) = await sent(browser)
    assert only["f"] == {"dry/1": {"actual": "1000", "mode": "local"}}
    assert (only["p"], only["n"], only["t"]) == (0, 1001, 1101.0)


async def test_a_merged_diff_leaves_the_shared_one_as_it_was() -> None:
    browser = Browser("anna", "operator", "en")
    first = diff(1, actual="1")
    browser.send_diff(first)
    browser.send_diff(diff(2, actual="2"))
    assert first.groups == {"dry/1": {"actual": "1"}}


async def test_all_who_missed_the_same_get_the_same_text() -> None:
    one, other = Browser("anna", "operator", "en"), Browser("bernd", "viewer", "en")
    for each in [diff(n, actual=str(n)) for n in range(1, 500)]:
        one.send_diff(each)
        other.send_diff(each)
    assert (await one.next())[0] is (await other.next())[0]


async def test_a_snapshot_makes_what_was_pending_worthless() -> None:
    browser = Browser("anna", "operator", "en")
    browser.send_diff(diff(1, actual="1"))
    browser.send({"is": "snapshot", "n": 1})
    browser.send_diff(diff(2, actual="2"))
    assert [(message["is"], message["n"]) for message in await sent(browser)] == [
        ("snapshot", 1),
        ("diff", 2),
    ]


async def test_frames_are_bounded() -> None:
    browser = Browser("anna", "operator", "en")
    browser.show_frames([{"hex": str(n)} for n in range(MAX_FRAMES + 50)])
    (message,) = await sent(browser)
    assert len(message["frames"]) == MAX_FRAMES
    assert message["frames"][0] == {"hex": "50"}


async def test_what_a_busy_socket_missed_goes_together() -> None:
    browser = Browser("anna", "operator", "en")
    waiting = asyncio.create_task(browser.next())
    await asyncio.sleep(0)
    browser.send_diff(diff(1, actual="1"))
    browser.send_diff(diff(2, actual="2"))
    (first,) = await waiting
    assert (json.loads(first)["p"], json.loads(first)["n"]) == (0, 2)
    browser.send_diff(diff(3, actual="3"))
    assert [message["n"] for message in await sent(browser)] == [3]
