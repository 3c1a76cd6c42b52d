"""What there is to photograph: situations that a line can be in, and the pages worth seeing in each.

A situation prepares the simulated line and gives the scenes. A scene is a path and, where a press is needed
first, what to press; with ``whole`` the picture is as long as the page.
"""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx
from playwright.sync_api import Page

from tests.e2e.limits import PROCEDURE_S
from tests.e2e.site import Site, eventually

DECELERATION, WINDOW, MAX_DISPLAY, DECIMALS, SETPOINT = 7, 12, 2, 3, 20
NAME = re.compile(r'^name = "(?!line")(.*)"$', re.MULTILINE)
LONG = " of the second coating line, dry end, drive side"
Press = Callable[[Page], None]


@dataclass(frozen=True, slots=True)
class Scene:
    """One picture. ``role`` "": nobody is signed in."""

    name: str
    path: str
    press: Press | None = None
    role: str = "engineer"
    whole: bool = False


@dataclass(frozen=True, slots=True)
class Situation:
    """How ``prepare`` leaves a line. Situations with the same ``line`` follow each other on one site."""

    name: str
    scenes: tuple[Scene, ...]
    prepare: Callable[[Site], Any]
    line: str = "coater"
    units: int = 8
    after: Callable[[Site], Any] | None = None
    """What befalls the site once a page is open; ``ends`` when the page shows it."""
    ends: str = ""


def press_all(*selectors: str, shows: str = "dialog[open]", fill: dict[str, str] | None = None) -> Press:
    """Fill the fields, press one thing after the other, wait for ``shows``."""

    def press(page: Page) -> None:
        for selector, text in (fill or {}).items():
            page.locator(selector).first.fill(text)
        for selector in selectors:
            page.locator(selector).first.click()
        page.wait_for_selector(shows)

    return press


def _confirm(page: Page) -> None:
    page.locator("[data-review-act]").click()
    page.wait_for_selector("[data-review-done]")


def _set(value: str, *, confirm: bool = False) -> Press:
    review = press_all("button[value=now]", fill={"#setpoint": value}, shows="[data-review-act]")

    def press(page: Page) -> None:
        review(page)
        if confirm:
            _confirm(page)

    return press


def _together(page: Page, *, confirm: bool = False) -> None:
    page.locator("[data-together-do=all]").first.click()
    page.locator("[data-together=scale]").first.fill("95")
    page.locator("[data-together-do=enter]").first.click()
    page.locator("form[data-setpoints] [type=submit]").first.click()
    page.wait_for_selector("[data-review-act]")
    if confirm:
        _confirm(page)


def _baud(page: Page) -> None:
    form = page.locator("#baud ~ form")
    form.locator("select").select_option("4800")
    form.locator("[type=submit]").click()
    page.wait_for_selector("[data-review-act]")


def _batch(page: Page) -> None:
    for unit, text in ((1, "5.5"), (2, "6"), (4, "7.5")):
        page.locator(f"[name=unit-{unit}]").fill(text)
    page.locator("main form.card [type=submit]").click()
    page.wait_for_selector("dialog[open]")


def _plan(page: Page) -> None:
    page.locator("form[action$='/restore'] [type=submit]").first.click()
    page.wait_for_selector("#restore")


def _restored(page: Page) -> None:
    _plan(page)
    page.locator("form[action$='/start'] [type=submit]").click()
    page.wait_for_selector("h2:has-text('Proof'), h2:has-text('Nachweis')", timeout=60_000)


GOLDEN_REVIEW = press_all("[hx-get^='/sets/golden']", shows="[data-review-act]")


def _taking(page: Page) -> None:
    GOLDEN_REVIEW(page)
    page.locator("[data-review-act]").click()
    page.wait_for_selector("#taking")


def _trace(page: Page) -> None:
    page.locator("[data-trace]").click()
    page.wait_for_selector("[data-frames] > *")


LINE = (Scene("line", "/"),)
VIEWS = (
    Scene("line-tiles", "/?view=tiles"),
    Scene("line-rows", "/?view=rows"),
    Scene("line-matrix", "/?view=matrix"),
    Scene("line", "/?view=auto"),
)
UNIT = "/units/line/3"
EMPTY = (
    Scene("sets-empty", "/sets", whole=True),
    Scene("recipes-empty", "/recipes", whole=True),
    Scene("shift-empty", "/shifts/present", whole=True),
    Scene("report-empty", "/reports?span=yesterday", whole=True),
    Scene("swap-without-set", "/swap/line/3"),
)
PAGES = (
    *VIEWS,
    Scene("line-viewer", "/", role="viewer"),
    Scene("unit", UNIT, whole=True),
    Scene("unit-viewer", UNIT, role="viewer", whole=True),
    Scene("unit-review", UNIT, _set("125.0")),
    Scene(
        "unit-refused", UNIT, press_all("button[value=now]", fill={"#setpoint": "999"}, shows=".field__error")
    ),
    Scene("unit-output", UNIT, press_all(".plate__outputs button", shows="[data-review-act]")),
    Scene("unit-more", UNIT, press_all(".plate__more summary", shows="#reason"), whole=True),
    Scene("zero", "/", press_all(".zero", shows="[data-review-act]")),
    Scene("parameters", UNIT + "/parameters", whole=True),
    Scene("setpoints", "/setpoints", whole=True),
    Scene("setpoints-review", "/setpoints", _together),
    Scene("trends", "/trends?s=line/3/actual&s=line/3/commanded", whole=True),
    Scene("events", "/events"),
    Scene("events-none", "/events?search=nothing-has-this-name"),
    Scene("alarms", "/alarms"),
    Scene("alarm-journal", "/alarms/journal"),
    Scene("alarm-performance", "/alarms/performance", whole=True),
    Scene("alarms-own", "/alarms/own", whole=True),
    Scene("shifts", "/shifts"),
    Scene("shift", "/shifts/present", whole=True),
    Scene("shift-note", "/shifts/present", press_all("main a[href$='/note']", shows="textarea"), whole=True),
    Scene("report", "/reports", whole=True),
    Scene("wallboard", "/wallboard"),
    Scene("lines", "/lines"),
    Scene("find", "/find?typed=nip"),
    Scene("help", "/help", whole=True),
    Scene("help-chapter", "/help/reports"),
    Scene("tray", "/tray"),
    Scene("notifications", "/notifications", role="admin", whole=True),
    Scene("configuration", "/configuration", role="admin", whole=True),
    Scene("configuration-bus", "/configuration/bus/0", role="admin", whole=True),
    Scene("bus", "/bus/line", whole=True),
    Scene("bus-trace", "/bus/line", _trace, whole=True),
    Scene("bus-baud", "/bus/line", _baud),
    Scene("sets", "/sets", whole=True),
    Scene("set", "/sets/1", whole=True),
    Scene("set-golden", "/sets", GOLDEN_REVIEW),
    Scene("set-taking", "/sets", _taking),
    Scene("compare", "/sets/compare?left=set:1:3&right=live:line:3", whole=True),
    Scene("compare-all", "/sets/compare?left=set:1:3&right=live:line:3&everything=true"),
    Scene("restore-choice", UNIT + "/restore"),
    Scene("restore-plan", "/sets/2", _plan, whole=True),
    Scene("batch", "/batch/line?number=6", whole=True),
    Scene("batch-review", "/batch/line?number=6", _batch),
    Scene("swap", "/swap/line/3"),
    Scene("recipes", "/recipes", whole=True),
    Scene("recipe", "/recipes/1", whole=True),
    Scene("recipe-review", "/recipes/1", press_all("main .button--act", shows="[data-review-act]")),
    Scene("users", "/users", role="admin", whole=True),
    Scene("user-menu", "/", press_all("[popovertarget=user-menu]", shows="#user-menu:popover-open")),
    Scene("legend", "/help/legend", whole=True),
    Scene("system", "/system", role="admin", whole=True),
    Scene("account", "/account", whole=True),
    Scene("login", "/login", role=""),
    Scene("login-panel", "/login?panel=true", role=""),
    Scene("not-found", "/units/line/99"),
    Scene("not-allowed", "/users"),
    Scene("offline", "/offline"),
)
ACTED = (
    Scene("unit-done", UNIT, _set("125.0", confirm=True)),
    Scene("setpoints-done", "/setpoints", lambda page: _together(page, confirm=True)),
    Scene("restored", "/sets/2", _restored, whole=True),
)
ABNORMAL = (
    *VIEWS,
    Scene(
        "line-faceplate",
        "/?view=tiles",
        press_all("[data-faceplate]", shows="#faceplate [data-faceplate-close]"),
    ),
    Scene("wallboard", "/wallboard"),
    Scene("alarms", "/alarms"),
    Scene("alarm", "/alarms", press_all("main a[href^='/alarms/line']", shows="main h1"), whole=True),
    Scene("events", "/events"),
    Scene("trends-alarms", "/trends?s=line/2/actual&s=line/3/actual&s=line/3/run"),
    Scene("unit-estop", "/units/line/2"),
    Scene("unit-local", "/units/line/5"),
    Scene("unit-lost", "/units/line/4"),
    Scene("unit-blocked", "/units/line/7", whole=True),
    Scene("setpoints", "/setpoints", whole=True),
    Scene("zero", "/", press_all(".zero", shows="[data-review-act]")),
    Scene("recipe", "/recipes/1", whole=True),
    Scene("set-golden", "/sets", GOLDEN_REVIEW),
)


def well(site: Site) -> None:
    """All at speed, an output on, a set with a golden mark, a recipe, some events."""
    for unit in range(1, site.units + 1):
        site.line.remote.do("input", unit=unit, input="run", on=True)
    with site.api("engineer") as client:
        client.put("/buses/line/units/3/outputs/1", json={"on": True}).raise_for_status()
        client.put("/buses/line/units/3/limits", json={"highest": 1500}).raise_for_status()
        client.get("/buses/line/units/3/parameters?refresh=true", timeout=60).raise_for_status()
        for name in ("before the new felt", "after the new felt"):
            body = {"name": name, "units": [3], "comment": "night shift"}
            client.post("/buses/line/sets", json=body, timeout=60).raise_for_status()
        client.post("/sets/1/golden", json={"unit": 3}).raise_for_status()
        client.put("/buses/line/units/3/parameters/6", json={"raw": 77}).raise_for_status()
        client.put("/buses/line/units/3/parameters/12", json={"raw": 21}).raise_for_status()
        recipe = {"name": "Board 80 g", "comment": "with the new blade"}
        client.post("/buses/line/recipes", json=recipe).raise_for_status()
    _settled(site)


def abnormal(site: Site) -> None:
    """An e-stop, a lost unit, LOCAL, off speed, a block."""
    do = site.line.remote.do
    do("input", unit=2, input="estop", on=True)
    do("fault", kind="dead", rate=1, unit=4)
    do("mode", unit=5, to="local")
    do("input", unit=6, input="run", on=False)
    with site.api("operator") as client:
        client.post("/buses/line/units/7/block", json={"reason": "belt off, do not run"}).raise_for_status()
    eventually(lambda: site.unit(4)["link"] == "offline", "a lost unit")
    eventually(lambda: site.unit(6)["actual_raw"] < 200, "a unit off speed", within=PROCEDURE_S)


def back_to_well(site: Site) -> None:
    """Undo :func:`abnormal`."""
    do = site.line.remote.do
    do("clear")
    do("input", unit=2, input="estop", on=False)
    do("mode", unit=5, to="remote")
    do("input", unit=6, input="run", on=True)
    with site.api("operator") as client:
        client.delete("/buses/line/units/7/block").raise_for_status()
    _settled(site)


def one_unit_off_speed(site: Site) -> None:
    """What a supervisor must see across the hall: one section creeps away, another is on its ramp."""
    do = site.line.remote.do
    do("parameter", unit=7, number=DECELERATION, raw=3000)
    with site.api("operator") as client:
        client.post("/buses/line/units/7/speed", json={"value": "60.0"}).raise_for_status()
    do("input", unit=5, input="run", on=False)
    eventually(lambda: site.unit(5)["actual_raw"] < 150, "a section that creeps away", within=PROCEDURE_S)


def long_names(site: Site) -> None:
    """Names of forty characters, speeds of five digits with three decimals."""
    site.stop()
    text = site.config.read_text(encoding="utf-8")
    site.config.write_text(NAME.sub(_longer, text), encoding="utf-8")
    for unit in range(1, site.units + 1):
        site.line.remote.do("parameter", unit=unit, number=MAX_DISPLAY, raw=99999)
        site.line.remote.do("parameter", unit=unit, number=DECIMALS, raw=3)
    site.start()
    site.wait_for_units()
    with site.api("operator") as client:
        setpoints = {str(unit): {"raw": 99999 - unit} for unit in range(1, site.units + 1)}
        client.post("/buses/line/speeds", json={"setpoints": setpoints}).raise_for_status()


def _longer(found: re.Match[str]) -> str:
    return f'name = "{(found[1] + LONG)[:40]}"'


def never_read(site: Site) -> None:
    """A server that has just begun, on a line that says nothing."""
    site.line.remote.do("fault", kind="dead", rate=1)
    site.stop()
    site.start()


def unplug(site: Site) -> None:
    """The cable is pulled."""
    site.line.remote.do("unplug")


def hold_worker(site: Site) -> None:
    """The worker's process is frozen."""
    assert site.server is not None
    children = Path(f"/proc/{site.server.pid}/task/{site.server.pid}/children").read_text().split()
    for child in children:
        os.kill(int(child), signal.SIGSTOP)


def all_unresponsive(site: Site) -> None:
    """Every unit is switched off."""
    site.line.remote.do("fault", kind="dead", rate=1)


def kill_server(site: Site) -> None:
    """The server is gone."""
    site.stop(signal.SIGKILL)


def abnormal_of_many(site: Site) -> None:
    """A few of very many."""
    for unit in (17, 18, 77, 140):
        site.line.remote.do("input", unit=unit, input="run", on=False)
    site.line.remote.do("input", unit=90, input="estop", on=True)
    site.line.remote.do("fault", kind="dead", rate=1, unit=200)
    site.line.remote.do("mode", unit=203, to="local")
    eventually(lambda: site.unit(200)["link"] == "offline", "a lost unit", within=180)
    eventually(lambda: site.unit(90)["inputs"]["estop"], "an e-stop seen", within=180)
    eventually(lambda: not site.unit(140)["inputs"]["run"], "a run input seen off", within=180)
    with site.api() as client:
        for unit in range(1, 97):
            eventually(partial(_window, client, unit), f"the window of unit {unit}", within=600)


def _window(client: httpx.Client, unit: int) -> int | None:
    """The at-speed window (#12), which a deviation is drawn in; None while it has not been read."""
    rows = client.get(f"/buses/line/units/{unit}/parameters").json()
    raw: int | None = rows[WINDOW - 1]["raw"]
    return raw


def nothing(_: Site) -> None:
    """As it is."""


def _settled(site: Site) -> None:
    with site.api() as client:
        eventually(
            lambda: all(
                unit["at_speed"] for bus in client.get("/line").json()["buses"] for unit in bus["units"]
            ),
            "the whole line at speed",
            within=PROCEDURE_S,
        )


MANY = (*VIEWS, Scene("setpoints", "/setpoints"), Scene("recipes", "/recipes"))
SITUATIONS = (
    Situation("new", EMPTY, nothing),
    Situation("well", PAGES, well),
    Situation("abnormal", ABNORMAL, abnormal),
    Situation("acted", ACTED, back_to_well),
    Situation("one-off", VIEWS, one_unit_off_speed),
    Situation("unplugged", (*LINE, Scene("unit", UNIT), Scene("bus", "/bus/line")), unplug),
    Situation("long", (*VIEWS, Scene("unit", UNIT), Scene("setpoints", "/setpoints")), long_names, "long"),
    Situation("stale", (*LINE, Scene("unit", UNIT)), all_unresponsive, "long"),
    Situation("never", (*VIEWS, Scene("unit", UNIT), Scene("setpoints", "/setpoints")), never_read, "never"),
    Situation("worker-gone", (*LINE, Scene("unit", UNIT)), hold_worker, "worker"),
    Situation("server-gone", LINE, nothing, "server", 3, kill_server, "body[data-link=lost]"),
    Situation("32", MANY, nothing, "32", 32),
    Situation("255", (*MANY, Scene("unit", UNIT)), nothing, "255", 255),
    Situation("255-abnormal", VIEWS, abnormal_of_many, "255", 255),
)
