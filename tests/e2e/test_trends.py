"""The history of a real line: what is drawn, how it is moved, what missing responses and a crash leave."""

from __future__ import annotations

import csv
import io
import re
import signal
import sqlite3
import time
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any
from urllib.parse import unquote

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.site import Site, eventually

OFFICE = {"width": 1280, "height": 900}
PINCH = """([left, right]) => {
  const picture = document.getElementById("trend-picture");
  const finger = (name, pointerId, clientX) =>
    picture.dispatchEvent(new PointerEvent(name, { pointerId, clientX, clientY: 300, pointerType: "touch" }));
  finger("pointerdown", 1, left);
  finger("pointerdown", 2, right);
  finger("pointermove", 2, right + (right - left));
}"""
PIXELS = """canvas => {
  const box = canvas.getBoundingClientRect();
  const over = document.querySelector("#trend-plot .u-over").getBoundingClientRect();
  const scale = canvas.width / box.width;
  const [top, height] = [Math.round((over.top - box.top) * scale), Math.round(over.height * scale)];
  const pixels = (part) => {
    const x = Math.round((over.left - box.left + (over.width * part) / 100) * scale);
    return canvas.getContext("2d").getImageData(x, top, 1, height).data;
  };
"""
"""The beginning of a function of the canvas: the pixels of the column at a part of the width, percent."""
COLUMNS = (
    PIXELS
    + """
  const column = (part) => pixels(part).filter((value, i) => i % 4 === 3 && value > 0).length;
  return Object.fromEntries([11, 51, 91].map((part) => [part, column(part)]));
}"""
)
STROKES = (
    PIXELS
    + """
  const strokes = (part) => {
    const data = pixels(part);
    const rows = Array.from({ length: height }, (_, y) => data.slice(4 * y, 4 * y + 4).join());
    const ground = rows.toSorted((a, b) =>
      rows.filter((row) => row === b).length - rows.filter((row) => row === a).length)[0];
    const runs = [];
    rows.forEach((row, y) => {
      if (row === ground) return;
      if (runs.length && runs.at(-1)[1] === y - 1) runs.at(-1)[1] = y;
      else runs.push([y, y]);
    });
    return runs.map(([first, last]) => (first + last + 1) / 2 / height);
  };
  return Object.fromEntries([11, 51, 91].map((part) => [part, strokes(part)]));
}"""
)
NOTHING = "\N{EN DASH}"
PHONE = {"width": 360, "height": 740}


@pytest.fixture(scope="module")
def own_site(line_server: Callable[..., Site]) -> Site:
    """Two units, for tests that hurt the server."""
    return line_server(2, line_options=("--no-script",))


def history(served: Site, value: str = "actual", seconds: float = 60, unit: int = 1) -> dict[str, Any]:
    """A value of the last so many seconds."""
    now = time.time()
    span = {
        name: datetime.fromtimestamp(t, UTC).isoformat() for name, t in (("from", now - seconds), ("to", now))
    }
    with served.api("viewer") as client:
        params: dict[str, str | int] = {"bus": "line", "unit": unit, "value": value, "points": 20_000, **span}
        response = client.get("/history", params=params)
    assert response.status_code == 200, response.text
    found: dict[str, Any] = response.json()
    return found


def opened(page: Page, query: str = "") -> Page:
    page.goto(f"/trends{query}")
    expect(page.locator("#trends[data-drawn]")).to_be_attached()
    return page


def view_of(page: Page) -> dict[str, str]:
    return dict(re.findall(r"[?&](\w+)=([^&]*)", page.evaluate("location.search")))


def span_of(page: Page) -> list[float]:
    """The two times of a view that follows no live values."""
    view = view_of(page)
    return [datetime.fromisoformat(unquote(view[name])).timestamp() for name in ("from", "to")]


def test_the_page_draws_and_follows_now(shared_page: OpensPages) -> None:
    page = opened(shared_page("viewer", viewport=OFFICE))
    expect(page.locator("#trend-values tr")).to_have_count(8)
    first = page.locator("#trends").get_attribute("data-drawn")
    page.locator('[data-span="600"]').click()
    expect(page.locator('[data-span="600"]')).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#trends")).not_to_have_attribute("data-drawn", first or "")
    assert view_of(page)["span"] == "600"
    expect(page.locator("#trend-plot canvas")).to_have_count(1)
    page.locator("[data-preset=shift]").click()
    expect(page.locator("[data-preset=shift]")).to_have_attribute("aria-pressed", "true")
    assert view_of(page)["preset"] == "shift"


def test_wheel_drag_and_keys_move_the_picture(shared_page: OpensPages) -> None:
    page = opened(shared_page("viewer", viewport=OFFICE), "?s=line/1/actual&span=600")
    picture = page.locator("#trend-plot .u-over")
    box = picture.bounding_box()
    assert box is not None
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.move(*middle)
    page.mouse.wheel(0, 200)
    eventually(lambda: page.evaluate("scrollY > 0"), "the page scrolled")
    assert "from=" not in page.evaluate("location.search")
    page.mouse.wheel(0, -200)
    eventually(lambda: page.evaluate("scrollY === 0"), "the page scrolled back")
    page.keyboard.down("Control")
    page.mouse.wheel(0, -200)
    eventually(lambda: "from" in view_of(page), "the picture zoomed")
    page.keyboard.up("Control")
    page.mouse.down()
    page.mouse.move(middle[0] + box["width"] / 4, middle[1], steps=5)
    before = page.evaluate("location.search")
    page.mouse.up()
    page.mouse.move(*middle)
    assert page.evaluate("location.search") == before
    view = view_of(page)
    assert "from" in view
    assert "to" in view
    page.locator("#trend-picture").focus()
    page.keyboard.press("l")
    eventually(lambda: "to" not in view_of(page), "live values")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("a")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("b")
    expect(page.locator("#time-difference")).not_to_have_text(NOTHING)
    page.keyboard.press("Escape")
    expect(page.locator("#time-difference")).to_have_text(NOTHING)


@pytest.mark.soak
def test_a_value_is_removed_by_keyboard_and_the_cursor_announced(shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport=OFFICE), "?s=line/1/actual&s=line/2/actual")
    rows = page.locator("#trend-values tr")
    page.locator("#trend-values button[aria-label]").first.press("Enter")
    expect(rows).to_have_count(1)
    expect(page.locator("#trend-values button[aria-label]")).to_be_focused()
    page.locator("#trend-picture").press("ArrowLeft")
    expect(page.locator("#trend-announcement")).to_contain_text("actual")
    page.locator("#trend-values button[aria-label]").press("Enter")
    expect(rows).to_have_count(0)
    expect(page.locator("#trend-add [name=unit]")).to_be_focused()


def test_gaps_are_gaps_and_a_band_is_drawn_between_least_and_greatest(browser_page: OpensPages) -> None:
    """uPlot's data is what the history returned; the colors are read from its canvas."""
    page = browser_page("viewer", viewport=OFFICE)
    t = [1_700_000_000 + i for i in range(100)]
    flat = [None if 40 <= i < 60 else 50.0 for i in range(100)]
    spread = {
        "min": [None if v is None else 10.0 for v in flat],
        "max": [None if v is None else 90.0 for v in flat],
    }
    response = {"bus": "line", "unit": 1, "value": "actual", "measure": "", "decimals": 1, "bucket_s": 1}
    body = [{**response, "t": t, "avg": flat, **spread}]
    page.route("**/api/v1/history/series*", lambda route: route.fulfill(json=body))
    moments = [datetime.fromtimestamp(at, UTC).isoformat().replace("+00:00", "Z") for at in (t[0], t[-1])]
    opened(page, f"?s=line/1/actual&from={moments[0]}&to={moments[1]}&marks=0")
    painted = page.locator("#trend-plot canvas").evaluate(COLUMNS)
    assert painted["11"] > painted["51"] * 3, painted
    assert painted["91"] > painted["51"] * 3, painted


@pytest.mark.soak
def test_a_bit_is_a_lane_high_while_it_is_on_and_empty_in_gaps(
    browser_page: OpensPages,
) -> None:
    """Two lanes of 1 in a scale from -0.2 to 2, the first above; on is 0.7 above the floor of its lane."""
    page = browser_page("viewer", viewport=OFFICE)
    t = [1_700_000_000 + i for i in range(100)]
    run = [None if 40 <= i < 60 else int(i < 40) for i in range(100)]
    bit = {"bus": "line", "unit": 1, "measure": "", "decimals": 0, "bucket_s": 1, "t": t}
    body = [
        bit | {"value": name, "avg": on, "min": on, "max": on}
        for name, on in (("run", run), ("remote", [1] * 100))
    ]
    page.route("**/api/v1/history/series*", lambda route: route.fulfill(json=body))
    moments = [datetime.fromtimestamp(at, UTC).isoformat().replace("+00:00", "Z") for at in (t[0], t[-1])]
    opened(page, f"?s=line/1/run&s=line/1/remote&from={moments[0]}&to={moments[1]}&marks=0")
    strokes = page.locator("#trend-plot canvas").evaluate(STROKES)
    on, off, other = (2 - 1.7) / 2.2, (2 - 1.0) / 2.2, (2 - 0.7) / 2.2
    assert strokes["11"] == pytest.approx([on, other], abs=0.03)
    assert strokes["51"] == pytest.approx([other], abs=0.03)
    assert strokes["91"] == pytest.approx([off, other], abs=0.03)


@pytest.mark.soak
def test_one_finger_pulls_the_picture_and_sets_no_cursor(browser_page: OpensPages) -> None:
    page = browser_page("viewer", viewport=PHONE, has_touch=True)
    opened(page, "?s=line/1/actual&from=2026-01-01T00:00:00Z&to=2026-01-01T00:10:00Z")
    width = page.locator("#trend-picture").evaluate("picture => picture.clientWidth")
    box = page.locator("#trend-plot .u-over").bounding_box()
    assert box is not None
    finger = page.context.new_cdp_session(page)

    def touch(kind: str, *places: tuple[float, float]) -> None:
        finger.send(
            "Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in places]}
        )

    start, y, pull = round(box["x"] + 20), round(box["y"] + 60), 120
    touch("touchStart", (start, y))
    for x in range(start, start + pull + 1, 10):
        touch("touchMove", (x, y))
    touch("touchEnd")
    began = datetime(2026, 1, 1, tzinfo=UTC).timestamp() - 600 * pull / width
    eventually(lambda: span_of(page) == pytest.approx([began, began + 600], abs=5), "the picture pulled")
    expect(page.locator("#trend-at")).not_to_have_text("Latest values")
    assert {"a", "b"}.isdisjoint(view_of(page))


@pytest.mark.soak
def test_two_presses_set_two_cursors_and_two_fingers_zoom(shared_page: OpensPages) -> None:
    page = opened(shared_page("viewer", viewport=OFFICE), "?s=line/1/actual&span=600")
    box = page.locator("#trend-plot .u-over").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 100, box["y"] + box["height"] / 2)
    page.mouse.click(box["x"] + 300, box["y"] + box["height"] / 2)
    expect(page.locator("#time-difference")).to_have_text(re.compile(r"\d"))
    page.mouse.click(box["x"] + 300, box["y"] + box["height"] / 2)
    expect(page.locator("#time-difference")).to_have_text(NOTHING)
    page.evaluate(PINCH, [box["x"] + 200, box["x"] + 400])
    began, ended = span_of(page)
    assert ended - began == pytest.approx(300, rel=0.05)


def test_copying_the_link_moves_nothing(shared_page: OpensPages) -> None:
    page = opened(shared_page("viewer", viewport=PHONE), "?s=line/1/actual")
    places = [page.locator(each) for each in ("#trend-copy", "#trend-plot")]
    before = [place.bounding_box() for place in places]
    places[0].click()
    expect(page.locator("#trend-copied")).to_contain_text("Link copied")
    expect(places[0]).to_have_text("Copied")
    assert [place.bounding_box() for place in places] == before


def test_the_legend_reads_at_the_cursor_and_the_export_is_what_the_page_shows(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page("viewer", viewport=OFFICE), "?s=line/1/commanded&s=line/2/run&span=30")
    box = page.locator("#trend-plot .u-over").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] * 0.8, box["y"] + 50)
    expect(page.locator("#trend-at")).to_have_text(re.compile(r"\d:\d\d:\d\d$"))
    value = page.locator("#trend-legend b").first
    expect(value).to_have_text(re.compile(r"^\d+\.\d"))
    assert float(value.inner_text().split()[0]) == site.unit(1)["commanded_raw"] / 10
    address = page.locator("#export-csv").get_attribute("href")
    assert address is not None
    with site.api("viewer") as client:
        head, *rows = csv.reader(io.StringIO(client.get(f"{site.url}{address}").text))
    names = [re.sub(r" \[.*", "", name) for name in head]
    assert names == ["\ufeffTime", "UTC offset", "Unwind commanded", "Infeed nip run"]
    times = [datetime.fromisoformat(row[0] + row[1]) for row in rows]
    assert {(b - a).total_seconds() for a, b in pairwise(times)} == {1}
    assert (times[-1] - times[0]).total_seconds() <= 30
    # A second without a reading, as a busy machine may have, is an empty cell.
    assert [head[column] for column in (2, 3) if not any(row[column] for row in rows)] == [], rows


def test_an_alarm_is_marked_in_the_picture_and_listed(site: Site, shared_page: OpensPages) -> None:
    def marked() -> bool:
        with site.api("viewer") as client:
            found = client.get("/alarms/occurrences", params={"unit": "line/2"}).json()
        return any(each["code"] == "estop_active" for each in found["occurrences"])

    with site.line.stopped(2):
        eventually(marked, "the alarm in the journal")
        page = opened(shared_page("viewer", viewport=OFFICE), "?s=line/2/actual&span=600")
        listed = page.locator("#trend-alarms-list li").filter(has_text="Emergency stop")
        expect(listed.first).to_contain_text("urgent")
        mark = page.locator("#trend-plot .trends__alarm[data-is=urgent]").last
        mark.locator(".alarm-priority__shape").click()
        expect(page.locator("#trend-alarms-list button:focus")).to_contain_text("Emergency stop")
        page.locator("#trend-marks").uncheck()
        expect(mark).to_have_count(0)
        expect(page.get_by_role("switch", name="2 Infeed nip")).to_be_visible()
    eventually(lambda: not site.unit(2)["inputs"]["estop"], "the stop released")
    opened(page, "?s=line/2/actual&span=600")
    last = page.locator("#trend-alarms-list .alarm-priority").last
    expect(last).to_have_attribute("data-is", "urgent cleared")


@pytest.mark.soak
@pytest.mark.parametrize(("locale", "actual"), [(GERMAN, "ist"), (ENGLISH, "actual")])
def test_it_is_accessible(
    shared_page: OpensPages, flaws: Callable[..., list[str]], locale: str, actual: str
) -> None:
    page = opened(shared_page("operator", locale=locale), "?s=line/1/actual&s=line/1/run&span=60&compare=day")
    page.evaluate("for (const each of document.querySelectorAll('#trends details')) each.open = true")
    expect(page.locator("#trend-summary")).to_contain_text(actual, ignore_case=True)
    assert flaws(page, locale) == []


@pytest.mark.soak
def test_a_killed_server_loses_a_second_at_most_and_no_event(own_site: Site) -> None:
    for kill in (1, 2, 3):
        began = time.time()
        raw = own_site.unit(1)["commanded_raw"]
        with own_site.api("operator") as client:
            response = client.post("/buses/line/units/1/speed", json={"raw": raw + 7, "execute": True})
            events = client.get("/events", params={"kind": "command"}).json()["events"]
        assert response.status_code == 200
        wait_for_reading_after(own_site, began + 1)
        killed = time.time()
        own_site.stop(signal.SIGKILL)
        time.sleep(2)  # a second of the history is empty
        own_site.start()
        own_site.wait_for_units()
        wait_for_reading_after(own_site, killed + 1)
        assert max(t for t in times_of(own_site) if t <= killed) > killed - 1.2
        for value in ("actual", "run"):
            assert history(own_site, value, 300)["avg"].count(None) >= kill
        with own_site.api("viewer") as client:
            after = client.get("/events", params={"kind": "command"}).json()["events"]
        assert {event["id"] for event in events} <= {event["id"] for event in after}
    own_site.command("audit", "verify")
    with sqlite3.connect(own_site.folder / "data" / "history.db") as connection:
        assert connection.execute("PRAGMA quick_check").fetchone() == ("ok",)


def wait_for_reading_after(served: Site, moment: float) -> None:
    eventually(lambda: max(times_of(served)) > moment, "new history")


def times_of(served: Site) -> list[float]:
    """Return when unit 1 responded, over the last five minutes."""
    return [datetime.fromisoformat(t).timestamp() for t in history(served, "actual", 300)["t"]] or [0.0]
