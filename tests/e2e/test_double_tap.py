"""Two taps within 30 ms on every button of every page change one thing.

The walk presses each kind of button once: what a press opens (a review, its strip, the undo) comes next. A
kind is what a button does, without the number of its unit or row. Between two pairs the test lets time pass.
"""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Error, Page, Request, expect

from tests.e2e.conftest import OpensPages
from tests.e2e.site import AT_REST, PASSWORD, Site, eventually, start_line
from tests.free_port import free_port

SCRIPT = Path(__file__).with_name("double_tap.js")
PAGES = (
    "/units/line/1",
    "/units/line/2",
    "/units/line/1/parameters",
    "/setpoints",
    "/tray",
    "/",
    "/?view=matrix",
    "/alarms",
    "/alarms/journal",
    "/alarms/own",
    "/recipes",
    "/sets",
    "/batch/line?number=6",
    "/swap/line/3",
    "/bus/line",
    "/trends",
    "/events",
    "/notifications",
    "/configuration",
    "/configuration/tables/bus.0.unit.1",
    "/configuration/versions/1",
    "/shifts/present",
    "/help",
    "/wallboard",
)
LINKED = (
    ("/alarms", r"/alarms/line\..*"),
    ("/recipes", r"/recipes/\d+"),
    ("/sets", r"/sets/(?!compare).+"),
    ("/shifts/present", r"/shifts/.*/note"),
)
"""A page, and the path of one that it links."""
MAX_MISSES = 8
"""Taps of one kind for which its review had closed before: a value of the unit had moved."""
DANGEROUS = (
    *(r'"take"', r'"release"', r'"request"', r'"decline"', r'"grant"', r"/alarms/acknowledge", r"/nudge"),
    *(r"/units/line/#/speed", r"/units/line/#/execute", r"/outputs/#", r"/parameters/# \|", r"/line/zero"),
    *(r"/setpoints \|", r"/tray/send", r"/tray/remove", r"/recipes/save", r"/recipes/#/load", r"/sets/take"),
    *(
        r"/batch/line/write",
        r"/swap/line/#",
        r"/shifts/.*/notes",
        r"/shifts/.*/sign",
        r"/logout",
        r"/silence",
    ),
    *(r"/restores/#/start", r"/users/operator/disable", r"/users/tokens"),
    *(r"/configuration/.* \| Write the file", r"/versions/#/roll-back", r"/account/password"),
)
"""Kinds of buttons that must have changed something, or the walk has judged nothing."""


STAYS = r"^(?!.*(/logout|/account/language))"
"""Not what ends the session, or changes the words of the buttons: both are in the menu of every page."""


def tap_twice(page: Page, x: float, y: float) -> None:
    """Press a place twice at times that are stated: a busy browser takes them with as little between."""
    at, devtools = time.time(), page.context.new_cdp_session(page)
    steps = [(kind, count) for count in (1, 2) for kind in ("mousePressed", "mouseReleased")]
    for number, (kind, count) in enumerate(steps):
        tap = {"x": x, "y": y, "button": "left", "clickCount": count, "timestamp": at + number / 100}
        devtools.send("Input.dispatchMouseEvent", {"type": kind, **tap})
    devtools.detach()


def middle_of(page: Page, name: str) -> tuple[float, float]:
    """The middle of a button."""
    box = page.get_by_role("button", name=name).bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@dataclass
class Walk:
    """Presses each kind of button that it has not seen, and keeps which change and which changed twice."""

    page: Page
    seen: set[str] = field(default_factory=set)
    sent: list[Request] = field(default_factory=list)
    under_way: set[Request] = field(default_factory=set)
    changing: set[str] = field(default_factory=set)
    missed: Counter[str] = field(default_factory=Counter)
    pressed: str = ""
    wrong: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Follow what the page sends."""
        self.page.add_init_script(path=SCRIPT)
        self.page.on("request", self._sends)
        for ended in ("requestfinished", "requestfailed"):
            self.page.on(ended, self._ended)
        # It takes two minutes, and what is judged is sent before.
        self.page.route("**/scan*", lambda route: route.fulfill(status=204))
        self.page.on("dialog", lambda dialog: dialog.accept())

    def _sends(self, request: Request) -> None:
        if request.method != "GET":
            self.sent.append(request)
        if request.resource_type in ("document", "fetch", "xhr"):
            self.under_way.add(request)

    def _ended(self, request: Request) -> None:
        self.under_way.discard(request)

    def visit(self, path: str, only: str = STAYS) -> None:
        """Press every kind of button of a page, and of what it opens; of those that match ``only``."""
        here, is_fresh = self._open(path), True
        while True:
            kinds = self._at_rest("buttons") if self._path() == here else []
            new = ((number, kind) for number, kind in enumerate(kinds) if self._is_new(kind, only))
            number, kind = next(new, (0, ""))
            place = self.page.evaluate("each => walk.place(...each)", [number, PASSWORD]) if kind else None
            if place:
                self._tap_twice(path, kind, place)
                is_fresh = False
            elif is_fresh and kind:
                self.seen.add(kind)
            elif is_fresh or self._path() == "/login":
                return
            else:
                here, is_fresh = self._open(path), True

    def _is_new(self, kind: str, only: str) -> bool:
        return kind not in self.seen and re.search(only, kind) is not None

    def _path(self) -> str:
        return urlsplit(self.page.url).path

    def _open(self, path: str) -> str:
        """Return the path of the page that was opened."""
        self.page.goto(path)
        expect(self.page.locator("body[data-link=live]")).to_be_attached()
        return self._path()

    def _at_rest(self, name: str) -> Any:
        """What the script finds on the page once all that was sent has its response."""

        def found() -> list[Any]:
            with suppress(Error):
                self.page.wait_for_load_state()
                if self.page.evaluate("walk.isAtRest()") and not self.under_way:
                    return [self.page.evaluate(f"walk.{name}()")]
            return []

        return eventually(found, "the end of what was sent")[0]

    def tap_once(self, name: str) -> None:
        """Press a button of the present page that is not judged."""
        self.page.evaluate("walk.later()")
        self.page.get_by_role("button", name=name).click()
        self._at_rest("presses")

    def _tap_twice(self, path: str, kind: str, place: list[float]) -> None:
        self.page.evaluate("walk.later()")
        self.sent.clear()
        tap_twice(self.page, *place)
        presses = self._at_rest("presses")
        # What came in between is under the finger: the button is pressed another time.
        if presses or self.missed[kind] == MAX_MISSES:
            self.seen.add(kind)
        else:
            # A review may have closed in between: what opened it is pressed another time, too.
            self.seen.discard(self.pressed)
        self.pressed = kind
        self.missed[kind] += 1
        if self.sent:
            self.changing.add(kind)
        if presses > 1 or len(self.sent) > 1:
            sent = ", ".join(f"{each.method} {each.url}" for each in self.sent)
            self.wrong.append(f"{path}: {kind}: {presses} presses: {sent}")


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Four units, the second in e-stop, of which one person at a time has control."""
    made = line_server(4, line_options=AT_REST, toml="[site]\ncontrol = true\n")
    made.line.remote.do("input", unit=2, input="estop", on=True)
    return made


def planned_restore(site: Site) -> str:
    """The page of a restore that would write one row."""
    unit = "/buses/line/units/1"
    with site.api("engineer") as client:
        client.post("/buses/line/control").raise_for_status()
        taken = client.post("/buses/line/sets", json={"units": [1]}).raise_for_status().json()
        client.put(f"{unit}/parameters/6", json={"raw": 77}).raise_for_status()
        plan = client.post(f"{unit}/restores", json={"set": taken["id"]}).raise_for_status().json()
        client.delete("/buses/line/control").raise_for_status()
    return f"/restores/{plan['id']}"


def first_link(page: Page, pattern: str) -> str:
    """The first link of a page to a path of a form."""
    paths: list[str] = page.locator("main a[href]").evaluate_all("all => all.map(one => one.pathname)")
    found = [path for path in paths if re.fullmatch(pattern, path)]
    assert found, f"{page.url} links no {pattern}"
    return found[0]


def press_control(site: Site, walk: Walk) -> None:
    """Every button about control; the person of the walk has it at the end."""
    walk.visit("/", "/control")
    with site.api("operator") as other:
        other.post("/buses/line/control").raise_for_status()
        walk.visit("/", '"(request|withdraw)"')
        other.delete("/buses/line/control").raise_for_status()
        walk.tap_once("Take control")
        other.post("/buses/line/control/request").raise_for_status()
        walk.visit("/", '"decline"')
    with site.api("engineer") as other:
        other.post("/buses/line/control/request").raise_for_status()
        walk.visit("/", '"grant"')
        other.delete("/buses/line/control").raise_for_status()
    walk.tap_once("Take control")


@pytest.mark.soak
def test_no_button_changes_two_things_by_two_taps(site: Site, browser_page: OpensPages) -> None:
    walk = Walk(browser_page("admin", viewport={"width": 1280, "height": 800}, taps=True))
    restore = planned_restore(site)
    press_control(site, walk)
    walk.visit(restore)
    for path in PAGES:
        walk.visit(path)
    for start, pattern in LINKED:
        walk.page.goto(start)
        walk.visit(first_link(walk.page, pattern))
    # Not those that end the session.
    walk.visit("/users", STAYS + "(?!post /users/admin)")
    walk.visit("/account", "^(?!.*logout)")
    walk.visit("/account", "logout")
    assert walk.wrong == []
    changed = "\n".join(sorted(walk.changing))
    assert [each for each in DANGEROUS if not re.search(each, changed)] == []


@pytest.fixture
def new_site(tmp_path: Path) -> Iterator[Site]:
    """A unit, and no user yet."""
    made = Site(tmp_path, start_line(tmp_path, 1, *AT_REST), f"http://127.0.0.1:{free_port()}", 1)
    try:
        made.configure()
        made.start()
        yield made
    finally:
        made.close()


@pytest.mark.soak
def test_two_taps_create_one_first_admin(new_site: Site, browser_page: OpensPages) -> None:
    page = browser_page(None, new_site, taps=True)
    sent: list[Request] = []
    page.on("request", lambda request: sent.append(request) if request.method == "POST" else None)
    page.goto("/setup")
    printed = (new_site.folder / "serve.log").read_text(encoding="utf-8")
    page.locator("[name=code]").fill(re.findall(r"[A-Z2-9]{4}(?:-[A-Z2-9]{4}){2}", printed)[-1])
    page.locator("[name=name]").fill("ada")
    page.locator("[name=password]").fill(PASSWORD)
    page.locator("[name=again]").fill(PASSWORD)
    tap_twice(page, *middle_of(page, "Create the first admin"))
    expect(page.locator("body[data-link=live]")).to_be_attached()
    assert len(sent) == 1
