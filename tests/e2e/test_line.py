"""The line as used by a person who knows only the command, the configuration and the API."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages, rest
from tests.e2e.limits import START_S
from tests.e2e.site import AT_REST, Site, eventually
from tests.e2e.site import site as one_site
from tests.sizes import in_turn

OFFICE = {"width": 1280, "height": 800}


@pytest.fixture(scope="module")
def own_site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Three units, for tests that hurt the server."""
    with one_site(tmp_path_factory.mktemp("hurt"), 3, line_options=AT_REST) as made:
        yield made


def acted(served: Site, command: int) -> list[dict[str, Any]]:
    """The writes that units carried out."""
    entries = served.line.remote.do("record", kinds=["acted"])
    return [entry for entry in entries if bytes.fromhex(entry["hex"])[1] == command]


def process_is_there(number: int) -> bool:
    try:
        return ") Z " not in Path(f"/proc/{number}/stat").read_text()
    except FileNotFoundError:
        return False


def children(number: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{number}/task/{number}/children").read_text().split()]


def test_the_page_shows_the_units_values(site: Site, shared_page: OpensPages) -> None:
    page = shared_page("viewer", viewport=OFFICE)
    page.goto("/")
    for unit in range(1, 9):
        raw = site.line.remote.do("state", unit=unit)["commanded"]
        expect(page.locator(f'[data-live="line/{unit}.commanded"]').first).to_have_text(f"{raw / 10:.1f}")


def test_a_speed_set_by_the_api_reaches_the_unit_once_and_the_page_by_reading(
    site: Site, shared_page: OpensPages
) -> None:
    page = shared_page("viewer", viewport=OFFICE)
    page.goto("/")
    before = len(acted(site, 0x84))
    with site.api("operator") as client:
        response = client.post("/buses/line/units/2/speed", json={"value": "123.4", "execute": True})
    assert (response.status_code, response.json()["outcome"]) == (200, "verified")
    assert site.line.remote.do("state", unit=2)["setpoint"] == 1234
    assert len(acted(site, 0x84)) == before + 1
    expect(page.locator('[data-live="line/2.commanded"]').first).to_have_text("123.4")


def test_a_unit_that_does_not_respond_is_shown_as_such_and_comes_back(
    site: Site, shared_page: OpensPages
) -> None:
    page = shared_page("viewer", viewport=OFFICE)
    page.goto("/")
    tile = page.locator('[data-unit="line/4"]').first
    site.line.remote.do("fault", kind="dead", rate=1, unit=4)
    try:
        eventually(lambda: site.unit(4)["link"] == "offline", "unit 4 offline")
        expect(tile).not_to_have_attribute("data-quality", "online")
    finally:
        site.line.remote.do("clear")
    eventually(lambda: site.unit(4)["link"] == "online", "unit 4 online")


BOXES = """selector => [...document.querySelectorAll(selector)].map(each => {
  const { x, y, width, height } = each.getBoundingClientRect();
  return [each.className, ...[x, y + scrollY, width, height].map(Math.round)].join(" ");
})"""
KEEP_THEIR_PLACES = ".tile, .tile__actual, .tile__actual .value__number, .totals > [data-is], .views"


@pytest.mark.parametrize(
    ("size", "locale"), [(OFFICE, ENGLISH), ({"width": 360, "height": 740}, GERMAN)], ids=["panel", "phone"]
)
def test_no_tile_moves_when_an_emergency_stop_comes_or_a_unit_is_opened(
    site: Site, browser_page: OpensPages, size: Any, locale: str
) -> None:
    site.end_alarms()
    page = browser_page("operator", viewport=size, locale=locale)
    page.goto("/?view=tiles")
    expect(page.locator("body")).to_have_attribute("data-link", "live")
    before = page.evaluate(BOXES, KEEP_THEIR_PLACES)
    try:
        site.line.remote.do("input", unit=2, input="estop", on=True)
        expect(page.locator('.tile[data-unit="line/2"]')).to_have_attribute("data-is", "urgent")
        expect(page.locator(".top__alarm-link")).not_to_have_attribute("data-is", "")
        assert page.evaluate(BOXES, KEEP_THEIR_PLACES) == before
        page.locator('[data-unit="line/4"] [data-faceplate]').click()
        expect(page.locator("#faceplate-name")).to_be_visible()
        assert page.evaluate(BOXES, KEEP_THEIR_PLACES) == before
        page.locator(".faceplate__state .status__text").evaluate(
            "each => each.textContent = 'cause '.repeat(40)"
        )
        rows = page.locator(".faceplate__state").evaluate("each => [each.scrollHeight, each.clientHeight]")
        assert rows[0] == rows[1], "a long cause lies over what follows"
    finally:
        site.line.remote.do("input", unit=2, input="estop", on=False)


@pytest.mark.parametrize(
    ("opened", "locale"),
    in_turn(
        [("/login", None), ("/users", "admin"), ("/account", "viewer"), ("/nothing", "viewer")],
        (ENGLISH, GERMAN),
        first=2,
    ),
)
def test_a_page_beside_the_line_is_accessible(
    shared_page: OpensPages, flaws: Callable[..., list[str]], opened: tuple[str, str | None], locale: str
) -> None:
    path, role = opened
    page = shared_page(role, locale=locale)
    page.goto(path)
    assert flaws(page, locale) == []


@pytest.mark.provokes("WebSocket connection")
def test_a_page_that_has_lost_its_server_shows_it_and_recovers(
    own_site: Site, browser_page: OpensPages
) -> None:
    page: Page = browser_page("operator", own_site, viewport=OFFICE)
    page.goto("/")
    expect(page.locator("body")).to_have_attribute("data-link", "live")
    own_site.stop(signal.SIGKILL)
    expect(page.locator("body")).to_have_attribute("data-link", "lost")
    own_site.start()
    expect(page.locator("body")).to_have_attribute("data-link", "live")


def test_sigterm_ends_all_of_it(own_site: Site) -> None:
    assert own_site.server is not None
    workers = children(own_site.server.pid)
    assert workers
    status = own_site.stop()
    left = [worker for worker in workers if process_is_there(worker)]
    own_site.start()
    assert (status, left) == (0, [])


def test_no_worker_outlives_a_killed_server(own_site: Site) -> None:
    assert own_site.server is not None
    workers = children(own_site.server.pid)
    own_site.stop(signal.SIGKILL)
    eventually(lambda: not any(map(process_is_there, workers)), "the end of the workers", within=START_S)
    own_site.start()


def test_a_worker_that_dies_is_started_again(own_site: Site) -> None:
    assert own_site.server is not None
    [worker] = children(own_site.server.pid)
    os.kill(worker, signal.SIGKILL)
    server = own_site.server.pid
    eventually(lambda: children(server) not in ([], [worker]), "another worker", within=START_S)
    own_site.wait_for_units()


FOR_A_PHONE = [
    "/users",
    "/account",
    "/nothing",
    "/events",
    "/sets",
    "/sets/compare",
    "/recipes",
    "/batch/line",
]
SMALL_TARGETS = """() => [...document.querySelectorAll("main :is(button, .button, select, input, .check)")]
  .filter((each) => each.checkVisibility() && each.getBoundingClientRect().height < 48)
  .filter((each) => !each.closest(".check") || each.matches(".check"))
  .map((each) => each.outerHTML.slice(0, 120))"""
HIDDEN_TO_THE_SIDE = """() => [...document.querySelectorAll("main .table-wrap")]
  .filter((each) => each.scrollWidth > each.clientWidth + 1).map((each) => each.ariaLabel)"""


@pytest.mark.soak
def test_the_pages_around_the_line_fit_a_phone_in_a_glove(browser_page: OpensPages) -> None:
    page = browser_page("admin", viewport={"width": 360, "height": 740}, has_touch=True, is_mobile=True)
    for path in FOR_A_PHONE:
        page.goto(path)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), path
        assert page.evaluate(SMALL_TARGETS) == [], path
        assert page.evaluate(HIDDEN_TO_THE_SIDE) == [], path


@pytest.mark.soak
def test_a_user_is_added_given_a_role_disabled_and_removed(
    shared_page: OpensPages, axe: Callable[..., list[str]]
) -> None:
    page = shared_page("admin", viewport={"width": 1920, "height": 1080})
    page.goto("/users")
    card = page.locator("section", has=page.get_by_role("heading", name="Add a user"))
    card.get_by_label("Name").fill("with space")
    card.get_by_label("Password").fill("a good new one")
    card.get_by_role("button", name="Add the user").click()
    expect(page.get_by_role("alert")).to_contain_text("write 1 to 40 letters, digits")
    assert axe(page) == []
    card.get_by_label("Name").fill("karin")
    card.get_by_label("Password").fill("a good new one")
    rest(page)
    card.get_by_role("button", name="Add the user").click()
    row = page.locator("[data-user=karin]")
    row.get_by_role("combobox").select_option("engineer")
    row.get_by_role("button", name="Change the role").click()
    expect(row.get_by_role("combobox")).to_have_value("engineer")
    rest(page)
    row.get_by_role("button", name="Disable the user").click()
    assert axe(page) == []
    rest(page)
    row.get_by_role("button", name="Remove the user").click()
    expect(page.locator("#review")).to_contain_text("is deleted permanently")
    page.get_by_role("button", name="Remove karin").click()
    expect(row).to_have_count(0)


@pytest.mark.soak
def test_a_token_is_revoked_after_a_confirmation(
    site: Site, shared_page: OpensPages, axe: Callable[..., list[str]]
) -> None:
    page = shared_page("admin", viewport={"width": 360, "height": 740})
    page.goto("/users")
    card = page.locator("section", has=page.get_by_role("heading", name="New token"))
    card.get_by_label("Name").fill("plc")
    card.get_by_role("button", name="Create the token").click()
    token = page.locator("[data-token]").inner_text()
    revoke = page.get_by_role("button", name="Revoke the token: plc")
    revoke.click()
    expect(page.locator("#review")).to_contain_text("Never used")
    assert axe(page) == []
    page.get_by_role("button", name="Cancel").click()
    bearer = {"Authorization": f"Bearer {token}"}
    assert httpx.get(f"{site.url}/api/v1/me", headers=bearer).status_code == 200
    revoke.click()
    page.get_by_role("button", name="Revoke plc").click()
    expect(revoke).to_have_count(0)
    assert httpx.get(f"{site.url}/api/v1/me", headers=bearer).status_code == 401
