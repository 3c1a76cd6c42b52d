"""The lines of a chart as people see them, and what they keep: dimmed lines, comparisons, notes, views."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import combinations
from typing import Any, Literal

import pytest
from playwright.sync_api import Page, Route, expect

from tests.e2e.conftest import OpensPages
from tests.e2e.pages import PANEL
from tests.e2e.site import Site

FROM, LENGTH = 1_700_000_000, 100
Color = tuple[float, float, float]
LINES = """canvas => {
  const probe = document.body.appendChild(document.createElement("i"));
  const [ground, grid] = ["--raised", "--line"].map((name) => {
    probe.style.color = `var(${name})`;
    return getComputedStyle(probe).color.match(/\\d+/g).slice(0, 3).map(Number);
  });
  probe.remove();
  const box = canvas.getBoundingClientRect();
  const over = document.querySelector("#trend-plot .u-over").getBoundingClientRect();
  const [left, top, height] = [over.left - box.left + 40, over.top - box.top, over.height].map(Math.round);
  const { data } = canvas.getContext("2d").getImageData(left, top, 140, height);
  const pixel = (x, y) => {
    const [r, g, b, alpha] = data.slice(4 * (140 * y + x), 4 * (140 * y + x) + 4);
    const seen = [r, g, b].map((part, i) => Math.round(ground[i] + ((part - ground[i]) * alpha) / 255));
    return String(seen) === String(grid) ? ground : seen;
  };
  const runs = [[]];
  for (let y = 0; y < height; y++) {
    const row = Array.from({ length: 140 }, (_, x) => pixel(x, y));
    const drawn = row.filter((color) => Math.hypot(...color.map((part, i) => part - ground[i])) > 40);
    if (drawn.length > 35) runs.at(-1).push(row);
    else if (runs.at(-1).length) runs.push([]);
  }
  return runs.filter((run) => run.length).map((run) => run[run.length >> 1]);
}"""
"""The pixels of the middle of each flat line, from the top; without the grid."""
EYES: dict[str, tuple[Color, Color, Color]] = {
    "normal": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "deuteranopia": (
        (0.367322, 0.860646, -0.227968),
        (0.280085, 0.672501, 0.047413),
        (-0.011820, 0.042940, 0.968881),
    ),
    "protanopia": (
        (0.152286, 1.052583, -0.204868),
        (0.114503, 0.786281, 0.099216),
        (-0.003882, -0.048116, 1.051998),
    ),
    "achromatopsia": ((0.2126, 0.7152, 0.0722),) * 3,
}
"""Of linear RGB (Machado, Oliveira and Fernandes 2009, severity 1; luminance alone)."""
NOTICEABLE = 10.0
"""Mean difference of two lines (CIE 1976) where they are most alike; 2.3 is just noticeable."""


def as_seen(pixel: Sequence[float], eye: str) -> Color:
    """A color of sRGB as L*a*b* of an eye."""
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in (c / 255 for c in pixel)]
    r, g, b = (
        min(1.0, max(0.0, sum(p * c for p, c in zip(part, linear, strict=True)))) for part in EYES[eye]
    )
    x, y, z = (
        v ** (1 / 3) if v > 0.008856 else 7.787 * v + 16 / 116
        for v in (
            (0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505,
            0.2126 * r + 0.7152 * g + 0.0722 * b,
            (0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089,
        )
    )
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def difference(one: list[Color], other: list[Color]) -> float:
    """Mean difference of two rows of pixels where the second is moved until they are most alike."""
    window = 120
    return min(
        sum(math.dist(a, b) for a, b in zip(one[:window], other[shift : shift + window], strict=True))
        / window
        for shift in range(len(other) - window)
    )


def lines_of(page: Page) -> list[list[Sequence[float]]]:
    found: list[list[Sequence[float]]] = page.locator("#trend-plot canvas").evaluate(LINES)
    return found


def flat(place: int, value: str = "actual", *, begins: int = 0) -> dict[str, Any]:
    """A response of the history: one value, all the time from a second on."""
    t = [FROM + i for i in range(begins, LENGTH)]
    level = [17.3 + 10.6 * (8 - place)] * len(t)
    of = {"bus": "line", "unit": place + 1, "value": value, "measure": "m/min", "decimals": 1, "bucket_s": 1}
    return {**of, "t": t, "avg": level, "min": level, "max": level}


def opened(page: Page, found: list[dict[str, Any]], more: str = "") -> list[str]:
    """Open the page over a span with these values, and return the addresses of what is requested of them."""
    requested: list[str] = []

    def respond(route: Route) -> None:
        requested.append(route.request.url)
        route.fulfill(json=found)

    page.route("**/api/v1/history/series*", respond)
    moments = (datetime.fromtimestamp(at, UTC) for at in (FROM, FROM + LENGTH - 1))
    since, until = (moment.strftime("%Y-%m-%dT%H:%M:%SZ") for moment in moments)
    series = "&".join(f"s=line/{each['unit']}/{each['value']}" for each in found)
    page.goto(f"/trends?{series}&from={since}&to={until}&marks=0{more}")
    expect(page.locator("#trends[data-drawn]")).to_be_attached()
    return requested


@pytest.mark.soak
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_eight_lines_differ_for_every_eye(browser_page: OpensPages, scheme: Literal["light", "dark"]) -> None:
    page = browser_page("viewer", viewport=PANEL, color_scheme=scheme)
    opened(page, [flat(place, "commanded" if place == 3 else "actual") for place in range(8)])
    lines = lines_of(page)
    assert len(lines) == 8
    for eye in EYES:
        seen = [[as_seen(pixel, eye) for pixel in line] for line in lines]
        alike = {(a + 1, b + 1): round(difference(seen[a], seen[b]), 1) for a, b in combinations(range(8), 2)}
        assert min(alike.values()) >= NOTICEABLE, (eye, alike)


@pytest.mark.soak
def test_a_line_is_dimmed_compared_and_what_was_not_read_is_in_words(browser_page: OpensPages) -> None:
    page = browser_page("viewer", viewport=PANEL)
    requested = opened(page, [flat(0, begins=50)])
    expect(page.locator("#trend-unread")).to_have_text(
        re.compile(r"No readings before 14 Nov 2023|\d\d:\d\d")
    )
    line = page.get_by_role("switch", name="1 Unwind")
    canvas = page.locator("#trend-plot canvas")
    bright = canvas.evaluate("canvas => canvas.toDataURL()")
    line.click()
    expect(line).to_have_attribute("aria-checked", "false")
    assert canvas.evaluate("canvas => canvas.toDataURL()") != bright
    page.locator("#trend-compare").select_option("day")
    expect(page.locator("#trend-past")).to_have_text("Dotted: the day before")
    day_before = datetime.fromtimestamp(FROM - 86_400, UTC).strftime("from=%Y-%m-%dT%H%%3A%M%%3A%S")
    assert any(day_before in address for address in requested)


@pytest.mark.soak
def test_a_note_is_written_on_the_chart_and_a_view_is_kept(site: Site, browser_page: OpensPages) -> None:
    page = browser_page("operator", viewport=PANEL)
    page.goto("/trends?s=line/2/actual&span=600")
    expect(page.locator("#trends[data-drawn]")).to_be_attached()
    page.get_by_text("Write a note").click()
    page.locator("#trend-note select").select_option("line/2")
    page.locator("#trend-note textarea").fill("Web break at the nip")
    page.get_by_role("button", name="Save note").click()
    expect(page.locator("#trend-note-result")).to_have_text("Note saved.")
    expect(page.locator("#trend-notes-list")).to_contain_text("Web break at the nip (operator)")
    with site.api("viewer") as client:
        events = client.get("/events", params={"kind": "shift"}).json()["events"]
    assert "Web break at the nip" in [event["message"] for event in events]
    page.get_by_text(re.compile("^Saved views")).click()
    page.locator("#trend-save [name=name]").fill("Infeed")
    page.get_by_role("button", name="Save view").click()
    expect(page).to_have_url(re.compile("span=600#trend-save$"))
    page.goto("/trends")
    page.get_by_text(re.compile("^Saved views")).click()
    page.get_by_role("link", name="Infeed").click()
    expect(page).to_have_url(re.compile("span=600$"))
    expect(page.locator("#trend-legend li")).to_have_count(1)
