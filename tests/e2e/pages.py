"""Pages in a browser that follow the line."""

from __future__ import annotations

from typing import Any

from playwright.sync_api import Page, ViewportSize, expect

PANEL: ViewportSize = {"width": 1280, "height": 800}
PHONE: ViewportSize = {"width": 360, "height": 740}

LIVE = "body[data-link=live]"
FITTED = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""The first frame after a window has changed fits the cells to it (js/line-fit.js)."""


def opened(page: Page, path: str) -> Page:
    """Open a page and wait until it follows the line."""
    page.goto(path)
    expect(page.locator(LIVE)).to_be_attached()
    return page


SIDES = ("left", "top", "right", "bottom")
COUNT_SHIFTS = """async ([part, sides]) => {
  await document.fonts.ready;
  await new Promise((painted) => requestAnimationFrame(() => requestAnimationFrame(painted)));
  const moved = (before, now) => sides.some((side) => Math.abs(before[side] - now[side]) >= 1);
  window.shifted = [];
  new PerformanceObserver((list) => {
    for (const entry of list.getEntries())
      for (const { node, previousRect, currentRect } of entry.sources)
        if (moved(previousRect, currentRect) && (!part || document.querySelector(part).contains(node))) {
          const what = (node?.outerHTML ?? node?.textContent ?? "a removed node").slice(0, 200);
          window.shifted.push([what, previousRect.toJSON(), currentRect.toJSON()]);
        }
  }).observe({ type: "layout-shift" });
}"""


def count_shifts(page: Page, part: str = "", sides: tuple[str, ...] = SIDES) -> None:
    """Note what the browser sees moving, in a part of the page or all of it, from the next painted frame on,
    after a press too. ``sides`` left and top alone: a text that grows has not moved."""
    page.evaluate(COUNT_SHIFTS, [part, sides])


def shifts(page: Page) -> Any:
    """What has moved since, and forget it."""
    return page.evaluate("() => window.shifted.splice(0)")


PAGES = {
    "/": "/",
    "/units/{bus}/{unit:int}": "/units/line/1",
    "/units/{bus}/{unit:int}/parameters": "/units/line/1/parameters",
    "/setpoints": "/setpoints",
    "/bus/{bus}": "/bus/line",
    "/alarms": "/alarms",
    "/alarms/{alarm_id}": "/alarms/line.1.estop_active.0",
    "/users": "/users",
    "/help": "/help",
    "/system": "/system",
    "/account": "/account",
    "/help/legend": "/help/legend",
    # The others are walked by ``make soak``.
    "/alarms/journal": "/alarms/journal",
    "/alarms/own": "/alarms/own?place=line/1&value=actual&above=1&days=1",
    "/alarms/performance": "/alarms/performance",
    "/batch/{bus}": "/batch/line?number=6",
    "/configuration": "/configuration",
    "/configuration/bus/{index}": "/configuration/bus/0",
    "/configuration/tables/{name}": "/configuration/tables/bus.0.unit.0",
    "/configuration/versions/{number}": "/configuration/versions/1",
    "/events": "/events?since=2026-01-01",
    "/find": "/find?typed=unwind",
    "/help/{name:path}": "/help/hardware",
    "/lines": "/lines",
    "/notifications": "/notifications",
    "/recipes": "/recipes",
    "/recipes/{recipe_id}": "/recipes/1",
    "/reports": "/reports?span=today",
    "/sets": "/sets",
    "/sets/compare": "/sets/compare",
    "/sets/{set_id}": "/sets/1",
    "/shifts": "/shifts",
    "/shifts/{start}": "/shifts/present",
    "/swap/{bus}/{unit}": "/swap/line/1",
    "/tray": "/tray",
    "/trends": "/trends",
    "/units/{bus}/{unit}/restore": "/units/line/1/restore",
    "/wallboard": "/wallboard",
}
"""An address of each page, by its route. What is there after an act alone, such as a recipe, may be the page
that says so."""
WALKED = (*PAGES.values(), "/?view=rows", "/?view=matrix")
BESIDE_THE_RAIL = (PAGES["/find"], "/lines", "/tray", "/wallboard")
"""Pages that no item of the rail stands for on a phone with one line."""
NEEDS_MORE = {
    "/docs": "a test of its own: thousands of elements",
    "/login": "nobody who is signed in",
    "/notifications/acknowledge": "the link of a mail",
    "/offline": "no server",
    "/restores/{restore_id}": "a restore that has been started",
    "/sets/taking/{taking_id}": "a reading that has been started",
    "/setup": "no user",
    "/shifts/{start}/note": "a shift in its address",
}
"""Pages that a walk does not open, and what they need."""
NO_PAGES = frozenset(
    {
        *("/alarms/list", "/alarms/own/values", "/bus", "/bus/{bus}/baud", "/bus/{bus}/control/{place}"),
        *("/bus/{bus}/first-steps", "/bus/{bus}/staged/review", "/bus/{bus}/tray/review", "/bus/{bus}/undo"),
        *(
            "/bus/{bus}/undo/{id}",
            "/bus/{bus}/units",
            "/bus/{bus}/scan",
            "/configuration/bus/{index}/scan",
            "/control",
        ),
        *("/favicon.ico", "/healthz", "/help/pictures/{name}", "/line/zero", "/live", "/login/oidc"),
        *("/login/oidc/callback", "/manifest.webmanifest", "/metrics", "/recipes/{recipe_id}/review"),
        "/recipes/{recipe_id}/retire",
        "/sets/golden",
        *("/shifts/pictures/{digest}", "/shifts/present", "/static/{version}/{name:path}", "/sw.js"),
        *("/swap/{bus}/{unit}/look", "/tray/strip", "/units/{bus}/{unit:int}/execute"),
        *("/units/{bus}/{unit:int}/faceplate", "/units/{bus}/{unit:int}/outputs/{number:int}"),
        *(
            "/units/{bus}/{unit:int}/unblock",
            "/units/{bus}/{unit}/drift",
            "/users/tokens/{name}/revoke",
            "/users/{name}/remove",
        ),
    }
)
"""Routes of files, redirections and parts of pages."""
