"""Speed felt: from a press to the first picture that shows it, and to the one with what was asked for, in a
Chromium slowed twice.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Page

from benchmarks.page import viewer_page
from benchmarks.tables import median, show
from tests.e2e.site import site

SLOWED = 2
PRESSES = 10
REST_MS = 1100
"""A second press within a second on the same button does nothing."""
WATCH = """([felt, done]) => {
  const message = new MessageChannel();
  const begun = { at: 0 };
  window.pressed = new Promise((resolve) => {
    const found = {};
    const before = new Set(document.querySelectorAll(`${felt}, ${done}`));
    const seen = (name, selector) => {
      if (name in found || ![...document.querySelectorAll(selector)].some((one) => !before.has(one))) return;
      found[name] = 0;
      message.port1.onmessage = () => {
        for (const each in found) found[each] ||= performance.now() - begun.at;
        if ('done' in found) resolve([found.felt, found.done]);
      };
      message.port2.postMessage(0);
    };
    const look = () => {
      seen('felt', felt);
      seen('done', done);
      if (!found.done) requestAnimationFrame(look);
    };
    addEventListener('click', (event) => {
      begun.at = event.timeStamp;
      requestAnimationFrame(look);
    }, { capture: true, once: true });
  });
}"""
"""The message comes after the frame whose callbacks found the selector: after its picture is laid out and
painted."""


@dataclass(frozen=True)
class Press:
    """``button`` is pressed on ``path``; ``felt`` matches what shows the press, ``done`` what was asked for,
    and ``undo`` is the key or the button that takes it away again."""

    name: str
    path: str
    button: str
    felt: str
    done: str
    undo: str


BUSY = "[aria-busy=true]"
PRESS = (
    Press(
        "open a unit",
        "/",
        ".tile__name a",
        "#faceplate:not([hidden])",
        "[data-faceplate-close]",
        "[data-faceplate-close]",
    ),
    Press("set line to zero", "/", ".zero", f".zero{BUSY}", "[data-review-act]", "[data-review-cancel]"),
    Press(
        "review a setpoint",
        "/units/line/1",
        "button[value=now]",
        f".button{BUSY}",
        "[data-review-act]",
        "[data-review-cancel]",
    ),
    Press("nudge", "/units/line/1", ".nudges .button", f".nudges {BUSY}", "#setpoint-error .result", ""),
    Press("find", "/", "[data-find]", "#find[open]", "#find[open]", "Escape"),
)


def run() -> None:
    """One table."""
    with (
        tempfile.TemporaryDirectory() as folder,
        site(Path(folder), installed=True) as served,
        viewer_page(served, "operator") as page,
    ):
        page.set_viewport_size({"width": 1280, "height": 800})
        devtools = page.context.new_cdp_session(page)
        devtools.send("Emulation.setCPUThrottlingRate", {"rate": SLOWED})
        rows = [_row(page, press) for press in PRESS]
    header = ["press", "first seen: median", "worst", "complete: median", "worst"]
    title = f"From a press to its picture, Chromium slowed {SLOWED} times, {PRESSES} presses each"
    show(title, header, rows, "First seen within 100 ms.")


def _row(page: Page, press: Press) -> list[str]:
    page.goto(press.path)
    page.wait_for_selector("body[data-link=live]")
    times = [_times(page, press) for _ in range(PRESSES)]
    felt, done = ([time[place] for time in times] for place in (0, 1))
    return [press.name, *(f"{time:.0f} ms" for each in (felt, done) for time in (median(each), max(each)))]


def _times(page: Page, press: Press) -> tuple[float, float]:
    """(ms until it is seen, ms until it is complete) of one press."""
    page.wait_for_timeout(REST_MS)
    page.evaluate(WATCH, [press.felt, press.done])
    page.locator(press.button).first.click()
    felt, done = page.evaluate("window.pressed")
    if press.undo == "Escape":
        page.keyboard.press(press.undo)
    elif press.undo:
        page.locator(press.undo).first.click()
    return felt, done
