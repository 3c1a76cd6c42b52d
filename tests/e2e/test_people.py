"""Many people at one line: who holds control; what keeps a unit from being set, on every path and page."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages, focus
from tests.e2e.limits import CALL_S, PROCEDURE_S
from tests.e2e.pages import LIVE, PANEL, opened
from tests.e2e.site import AT_REST, NO_TENSION_ALARM, ONE_REQUEST, Site, eventually
from tests.sizes import sizes


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Three units, of which one person at a time holds control."""
    toml = "[site]\ncontrol = true\n" + NO_TENSION_ALARM
    return line_server(3, line_options=AT_REST, toml=toml)


@pytest.fixture
def holder(site: Site) -> Iterator[httpx.Client]:
    """Yield a program of an admin that holds control; it may request pages too."""
    with httpx.Client(
        base_url=site.url,
        headers={"Authorization": f"Bearer {site.tokens['admin']}"},
        timeout=CALL_S,
        limits=ONE_REQUEST,
        trust_env=False,
    ) as client:
        assert (
            client.post("/api/v1/buses/line/control/hand-over", json={"to": "admin-program"}).status_code
            == 200
        )
        yield client
        client.request("DELETE", "/api/v1/buses/line/control")


@pytest.fixture(scope="module")
def pages(site: Site) -> list[str]:
    """Every page there is, with something on it."""
    with site.api("admin") as client:
        client.post("/buses/line/control")
        stored = client.post("/buses/line/sets", json={"name": "as it was", "comment": ""}).json()
        recipe = client.post(
            "/buses/line/recipes", json={"name": "Board", "setpoints": {"1": 700, "2": 710}}
        ).json()
        planned = client.post("/buses/line/units/3/restores", json={"set": stored["id"], "from_unit": 1})
        assert planned.status_code == 201, planned.text
        client.delete("/buses/line/control")
    return [
        *("/", "/?view=rows", "/?view=matrix", "/setpoints", "/trends", "/events", "/bus/line"),
        *("/units/line/1", "/units/line/1/parameters", "/units/line/1/restore", "/swap/line/1"),
        *("/sets", f"/sets/{stored['id']}", "/batch/line", f"/restores/{planned.json()['id']}"),
        *("/recipes", f"/recipes/{recipe['id']}", "/users", "/account"),
    ]


def setpoint(site: Site, unit: int) -> int:
    found: int = site.line.remote.do("state", unit=unit)["setpoint"]
    return found


# --- control --------------------------------------------------------------------------------------


@pytest.mark.usefixtures("holder")
def test_who_does_not_hold_control_sets_nothing(site: Site, shared_page: OpensPages) -> None:
    before = site.writes()
    page = opened(shared_page("operator", viewport=PANEL), "/units/line/1")
    expect(page.locator(".top")).to_contain_text("admin-program")
    page.locator(".nudges button").nth(2).click()
    expect(page.locator("#setpoint-error")).to_contain_text("Control: admin-program (token)")
    page.locator("#setpoint").fill("55.0")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("#setpoint-error")).to_contain_text("Control: admin-program (token)")
    page.get_by_role("button", name="Set line to zero").click()
    expect(page.locator("#review")).to_contain_text("left out: admin-program (token) has control")
    expect(page.locator("[data-review-act]")).to_have_count(0)
    expect(page.locator("#review").get_by_role("button", name="Request control")).to_be_visible()
    zero = page.request.post(
        "/line/zero", form={"id": "z" * 32, "reviewed_at": "9999999999"}, headers={"Origin": site.url}
    )
    assert "0 of 3 units accepted speed 0" in zero.text()
    with site.api("operator") as client:
        response = client.post("/buses/line/units/1/speed", json={"raw": 550})
    assert (response.status_code, response.json()["code"]) == (409, "controlled")
    assert site.writes() == before


PLACES = """[...document.querySelectorAll('main, .top :is(a, button)')].map(each => {
    const { left, top, width } = each.getBoundingClientRect();
    const isThere = each.checkVisibility({ visibilityProperty: true }) && !each.closest('[data-requested]');
    return isThere && [left, top, width];
}).filter(Boolean)"""
"""Where the page begins below the head, and each button of the head is."""


def test_control_is_requested_in_the_head_and_a_refused_setpoint_goes_on(
    site: Site, shared_page: OpensPages, browser_page: OpensPages, axe: Callable[..., list[str]]
) -> None:
    anna = opened(shared_page("operator", viewport=PANEL), "/alarms")
    anna.locator("[data-head-control]").get_by_role("button", name="Take control").click()
    expect(anna.locator("[data-head-control]")).to_contain_text("You have control")
    ben = opened(browser_page("engineer", viewport={"width": 360, "height": 740}), "/units/line/2")
    before, places = setpoint(site, 2), anna.evaluate(PLACES)
    ben.locator("#setpoint").fill("71.5")
    ben.get_by_role("button", name="Set now").click()
    offer = ben.locator("[data-control-offer]")
    offer.get_by_role("button", name="Request control").press("Enter")
    expect(offer).to_contain_text("Asked: operator")
    expect(anna.locator("[role=alert]")).to_contain_text("engineer requests control")
    assert anna.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert anna.evaluate(PLACES) == places, "a request moves and hides nothing"
    assert axe(anna, part=".top") == []
    anna.get_by_role("button", name="Hand over control").click()
    expect(ben.locator("[data-head-control]")).to_contain_text("You have control")
    assert setpoint(site, 2) == before
    offer.get_by_role("button", name="Continue").click()
    expect(ben.locator("[data-review-act]")).to_have_text(re.compile("to 71.5"))
    ben.locator("[data-review-act]").click()
    expect(ben.locator("[data-review-done=good]")).to_contain_text("71.5")
    ben.keyboard.press("Escape")
    ben.get_by_role("button", name="Release control").click()
    ben.locator("#setpoint").fill("72.5")
    ben.get_by_role("button", name="Set now").click()
    offer.get_by_role("button", name="Take control and continue").click()
    expect(ben.locator("[data-review-act]")).to_have_text(re.compile("to 72.5"))
    ben.keyboard.press("Escape")
    ben.get_by_role("button", name="Release control").click()
    expect(anna.locator("[data-head-control]")).to_contain_text("Control is free")


IN_REACH = """buttons => buttons.every(button => {
    const { left, top, width, height } = button.getBoundingClientRect();
    return button.contains(document.elementFromPoint(left + width / 2, top + height / 2));
})"""


@pytest.mark.soak
@pytest.mark.parametrize("locale", [ENGLISH, GERMAN])
def test_a_request_for_control_is_accessible_and_covers_nothing_of_the_head(
    site: Site, browser_page: OpensPages, flaws: Callable[[Page, str], list[str]], locale: str
) -> None:
    page = opened(browser_page("operator", viewport=PANEL, locale=locale), "/units/line/2")
    page.locator("[data-head-control] button").click()
    with site.api("engineer") as client:
        eventually(lambda: client.post("/buses/line/control/request").status_code == 200, "a holder")
        try:
            expect(page.locator("[data-requested]")).to_be_visible()
            expect(page.locator("[data-requested] [inert]")).to_have_count(0)
            for width in (320, 360, 700, 1024, 1280, 1920):
                page.set_viewport_size({"width": width, "height": 800})
                buttons = page.locator(".top button:visible, .top a.button:visible")
                assert buttons.evaluate_all(IN_REACH), width
            assert flaws(page, locale) == []
            expect(page.locator("[data-requested]")).to_be_visible()
        finally:
            client.delete("/buses/line/control/request")
            expect(page.locator("[data-requested]")).to_have_count(0)
            page.locator("[data-head-control] button").click()


# --- limits and blocks ----------------------------------------------------------------------------

STATUS = {"load": 409, "write": 200}
"""A recipe states why it cannot be loaded; a batch has an outcome for each row."""
SENDS: list[tuple[str, str, dict[str, Any]]] = [
    ("POST", "/api/v1/buses/line/units/1/speed", {"json": {"raw": 900, "confirm": True}}),
    ("POST", "/api/v1/buses/line/units/1/speed", {"json": {"raw": 900, "execute": False, "confirm": True}}),
    ("POST", "/api/v1/buses/line/speeds", {"json": {"setpoints": {"1": {"raw": 900}}, "confirm": True}}),
    ("PUT", "/api/v1/buses/line/units/1/parameters/20", {"json": {"raw": 900, "confirm": True}}),
    ("POST", "/units/line/1/review", {"data": {"value": "90.0"}}),
    ("POST", "/units/line/1/speed", {"data": {"raw": "900", "how": "now", "id": "a" * 32}}),
    ("POST", "/units/line/1/nudge", {"data": {"step": "300", "id": "b" * 32}}),
    ("POST", "/setpoints/review", {"data": {"bus": "line", "new-1": "90.0"}}),
    ("POST", "/setpoints", {"data": {"bus": "line", "raw-1": "900", "id": "c" * 32}}),
    ("POST", "/batch/line/write", {"data": {"number": "20", "unit-1": "90.0", "id": "e" * 32}}),
]
ALSO_BLOCKED: list[tuple[str, str, dict[str, Any]]] = [
    ("POST", "/api/v1/buses/line/units/1/execute", {}),
    ("PUT", "/api/v1/buses/line/units/1/outputs/1", {"json": {"on": True}}),
    ("PUT", "/api/v1/buses/line/units/1/analog-output", {"json": {"raw": 0}}),
    ("PUT", "/api/v1/buses/line/units/1/parameters/6", {"json": {"raw": 55}}),
    ("POST", "/units/line/1/parameters/6", {"data": {"raw": "55", "id": "d" * 32}}),
    ("POST", "/batch/line/write", {"data": {"number": "6", "unit-1": "5.5", "id": "f" * 32}}),
]


def press(
    client: httpx.Client, site: Site, method: str, path: str, arguments: dict[str, Any]
) -> httpx.Response:
    """As a page or a program sends it, to a unit that responds, with what a review would have put into the
    form. That of a parameter holds its value, and may come without."""
    eventually(lambda: site.unit(1)["link"] == "online", "unit 1 responds")
    form = dict(arguments.get("data", {}))
    if form:
        present = str(setpoint(site, 1))
        is_parameter = path.startswith("/batch/") or "/parameters/" in path
        reviewed = {} if is_parameter else {"was": present, "was-1": present}
        reviewed |= {"scale": "-", "scale-1": "-"}
        form = {**reviewed, "reviewed_at": "9999999999", **form}
        arguments = {"data": form, "headers": {"HX-Request": "true", "Accept": "text/html"}}
    return client.request(method, path, **arguments)


@pytest.fixture
def staged_and_saved(site: Site, holder: httpx.Client) -> Iterator[int]:
    """A recipe with 90.0 for unit 1, which is at 60.0."""
    api = "/api/v1/buses/line"
    assert holder.post(f"{api}/units/1/speed", json={"raw": 600}).status_code == 200
    eventually(lambda: site.unit(1)["commanded_raw"] == 600, "unit 1 at 60.0")
    for unit in (1, 2):  # a recipe needs the mode of each, which is read after the start
        holder.get(f"{api}/units/{unit}/parameters", params={"refresh": "true"}).raise_for_status()
    recipe = holder.post(f"{api}/recipes", json={"name": "Fast", "setpoints": {"1": 900, "2": 610}}).json()
    yield int(recipe["id"])
    holder.put(f"{api}/units/1/limits", json={})
    holder.request("DELETE", f"{api}/units/1/block")


def test_limits_hold_and_a_large_step_wants_a_review_on_every_path(
    site: Site, holder: httpx.Client, staged_and_saved: int
) -> None:
    assert holder.put("/api/v1/buses/line/units/1/limits", json={"highest": 800}).status_code == 200
    before = site.writes()
    load: tuple[str, str, dict[str, Any]] = (
        "POST",
        f"/api/v1/recipes/{staged_and_saved}/load",
        {"json": {"confirm": True}},
    )
    for method, path, arguments in [*SENDS, load]:
        response = press(holder, site, method, path, arguments)
        assert response.status_code == STATUS.get(path.rpartition("/")[2], 422), (path, response.text)
        assert site.writes() == before, path
    assert setpoint(site, 1) == 600

    assert holder.put("/api/v1/buses/line/units/1/limits", json={"largest_step": 50}).status_code == 200
    for path, body in (
        ("/api/v1/buses/line/units/1/speed", {"raw": 900}),
        ("/api/v1/buses/line/speeds", {"setpoints": {"1": {"raw": 900}}}),
        (f"/api/v1/recipes/{staged_and_saved}/load", {}),
    ):
        response = holder.post(path, json=body)
        assert (response.status_code, response.json()["code"]) == (409, "confirm_needed"), path
    nudged = press(holder, site, "POST", "/units/line/1/nudge", {"data": {"step": "51", "id": "e" * 32}})
    assert "data-review-act" in nudged.text
    assert site.writes() == before
    assert press(
        holder, site, "POST", "/units/line/1/nudge", {"data": {"step": "50", "id": "f" * 32}}
    ).is_success
    assert setpoint(site, 1) == 650


@pytest.mark.soak
def test_a_block_holds_on_every_path(site: Site, holder: httpx.Client, staged_and_saved: int) -> None:
    api = "/api/v1/buses/line"
    assert holder.post(f"{api}/units/1/speed", json={"raw": 640, "execute": False}).status_code == 200
    other = {"set": _a_set(holder), "from_unit": 2, "include": [20]}
    planned = holder.post(f"{api}/units/1/restores", json=other).json()
    assert holder.post(f"{api}/units/1/block", json={"reason": "belt off since 14:20"}).status_code == 200
    before = site.writes()
    more: list[tuple[str, str, dict[str, Any]]] = [
        ("POST", f"/api/v1/recipes/{staged_and_saved}/load", {"json": {"confirm": True}}),
        ("POST", f"{api}/execute", {}),
        ("POST", "/line/zero", {"data": {"id": "g" * 32}}),
    ]
    for method, path, arguments in [*SENDS, *ALSO_BLOCKED, *more[:2]]:
        response = press(holder, site, method, path, arguments)
        expected = 200 if path == "/setpoints/review" else STATUS.get(path.rpartition("/")[2], 423)
        assert response.status_code == expected, (path, response.text)
        assert "belt off since 14:20" in response.text, (path, response.text)
        assert site.writes() == before, path
    holder.post(f"/api/v1/restores/{planned['id']}/start")
    ended = eventually(lambda: _ended(holder, planned["id"]), "the end of the restore", within=PROCEDURE_S)
    assert "belt off" in str(ended)
    assert site.writes() == before
    assert "left out: commands blocked" in press(holder, site, *more[2]).text
    assert setpoint(site, 1) == 600


def _a_set(client: httpx.Client) -> int:
    number: int = client.post("/api/v1/buses/line/sets", json={"name": "now", "comment": ""}).json()["id"]
    return number


def _ended(client: httpx.Client, restore: str) -> Any:
    spoken = client.get(f"/api/v1/restores/{restore}").json()
    return spoken if spoken["state"] not in ("planned", "running", "proving") else None


# --- every page -----------------------------------------------------------------------------------

UNREACHABLE = """() => [...document.querySelectorAll(
        "[hx-get]:not([hx-trigger], form), [hx-post]:not(form), [data-pad], [data-command]:not(form)")]
    .filter(element => element.tabIndex < 0 || !element.matches("a[href], button, input, select, summary"))
    .map(element => element.outerHTML.slice(0, 120))"""


@pytest.mark.parametrize("every", sizes(10, 1))
def test_on_every_page_a_block_is_shown_and_zero_is_one_press_and_one_confirm_by_keyboard(
    site: Site, shared_page: OpensPages, pages: list[str], every: int
) -> None:
    page = opened(shared_page("admin", viewport=PANEL), "/units/line/1")
    with site.api("admin") as client:
        client.post("/buses/line/control/hand-over", json={"to": "admin"}).raise_for_status()
    page.locator("summary").click()
    page.locator("#reason").fill("belt off since 14:20")
    page.get_by_role("button", name="Block commands to Unwind").click()
    expect(page.locator(".plate__set")).to_contain_text("belt off since 14:20")
    before = site.writes()
    unsaid = []
    for path in pages[::every]:
        opened(page, path)
        # Of the head no line breaks within it.
        shown = page.locator("body").inner_text().replace("\u00a0", " ")
        if path != "/account" and "belt off since 14:20" not in shown:
            unsaid.append(path)
        assert page.evaluate(UNREACHABLE) == [], path
        button = page.get_by_role("button", name="Set line to zero")
        button.focus()
        page.keyboard.press("Enter")
        expect(page.locator("[data-review-act]")).to_have_text("Set 2 units to speed 0")
        expect(page.get_by_role("button", name="Cancel")).to_be_focused()
        page.keyboard.press("Escape")
        expect(page.locator("dialog[open]")).to_have_count(0)
        expect(button).to_be_focused()
    assert unsaid == []
    assert site.writes() == before
    opened(page, "/units/line/1")
    page.get_by_role("button", name="Lift the command block of Unwind").click()
    expect(page.locator("dialog[open]")).to_contain_text("belt off since 14:20")
    expect(page.get_by_role("button", name="Cancel")).to_be_focused()
    page.get_by_role("button", name="Lift the command block", exact=True).click()
    expect(page.locator("#setpoint-error")).to_contain_text("Command block lifted: belt off since 14:20")
    expect(page.locator("#setpoint")).to_be_visible()
    with site.api() as client:
        events = client.get("/events", params={"kind": "block", "limit": 2}).json()["events"]
    assert [(event["who"], event["what"]) for event in events] == [
        ("admin", "command block lifted"),
        ("admin", "commands blocked"),
    ]


MAX_AT_ONCE = 7
"""All of them together leave a small machine no time."""


@pytest.mark.soak
@pytest.mark.provokes("WebSocket", "fetch")
def test_every_page_is_covered_without_its_server_and_sends_nothing(
    site: Site, browser_page: OpensPages, pages: list[str]
) -> None:
    context = browser_page("admin", viewport=PANEL).context
    before = site.writes(), newest_event(site)
    opened_tabs = [context.new_page() for _ in pages[:MAX_AT_ONCE]]
    for first in range(0, len(pages), MAX_AT_ONCE):
        paths = pages[first : first + MAX_AT_ONCE]
        tabs = {path: opened(tab, path) for path, tab in zip(paths, opened_tabs, strict=False)}
        covered_while_the_server_stands(site, tabs)
        for path, tab in tabs.items():
            expect(tab.locator(LIVE), path).to_be_attached()
            expect(tab, path).to_have_url(re.compile(re.escape(path)))
    assert (site.writes(), newest_event(site)) == before


def covered_while_the_server_stands(site: Site, tabs: dict[str, Page]) -> None:
    """Check that each page is covered, disables its buttons, and sends no form."""
    assert site.server is not None
    site.server.send_signal(signal.SIGSTOP)
    try:
        for path, tab in tabs.items():
            expect(tab.locator("body[data-link=lost]"), path).to_be_attached()
            expect(tab.locator(".gone__box"), path).to_be_visible()
            assert tab.evaluate(
                "[...document.querySelectorAll('.main, .rail, .top')].every(part => part.inert)"
            )
            tab.evaluate("for (const form of document.querySelectorAll('form')) form.requestSubmit()")
    finally:
        site.server.send_signal(signal.SIGCONT)


def newest_event(site: Site) -> int:
    """Return the newest event of a person; a suspended server adds others."""
    with site.api() as client:
        events = client.get("/events", params={"limit": 20}).json()["events"]
    automatic = ("server", "worker", "clock", "bus", "unit")
    return max((event["id"] for event in events if event["kind"] not in automatic), default=0)


# --- screen reader texts, and where the focus stays -----------------------------------------------

LISTEN = """() => {
    window.announced = [];
    new MutationObserver(changes => {
        for (const {target} of changes) {
            const region = (target.nodeType === 3 ? target.parentElement : target)
                ?.closest("[aria-live]:not([aria-live=off]), [role=status], [role=alert]");
            if (region) window.announced.push(region.textContent.trim());
        }
    }).observe(document.body, {subtree: true, childList: true, characterData: true});
}"""


@pytest.mark.parametrize("path", sizes("/units/line/2", "/", "/setpoints"))
def test_a_screen_reader_gets_the_verdict_and_no_figures(
    site: Site, shared_page: OpensPages, holder: httpx.Client, path: str
) -> None:
    """Also of a unit that was abnormal before, as one in LOCAL is."""
    page = opened(shared_page("viewer", viewport=PANEL), path)
    site.line.remote.do("mode", unit=3, to="local")
    expect(page).to_have_title(re.compile(r"^\(\d"))
    page.evaluate(LISTEN)
    site.line.remote.do("input", unit=3, input="estop", on=True)
    try:
        holder.post("/api/v1/buses/line/units/2/speed", json={"raw": 300})
        holder.post("/api/v1/buses/line/units/2/speed", json={"raw": 350})
        eventually(
            lambda: any("emergency stop" in text for text in page.evaluate("window.announced")),
            "it was announced",
        )
        spoken = page.evaluate("window.announced")
    finally:
        site.line.remote.do("input", unit=3, input="estop", on=False)
        site.line.remote.do("mode", unit=3, to="remote")
        site.end_alarms("line.3.")
    assert not any(re.search(r"\d\.\d|ramping", text) for text in spoken), spoken


@pytest.mark.soak
def test_focus_stays_while_a_unit_does_not_respond(site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page("operator", viewport=PANEL), "/units/line/2")
    field = page.locator("#setpoint")
    focus(field)
    page.keyboard.type("4")
    site.line.remote.do("fault", kind="dead", rate=1, unit=2)
    try:
        expect(page.locator("form.setter[inert]")).to_be_attached()
    finally:
        site.line.remote.do("clear")
    expect(field).to_be_focused()
    page.keyboard.type("5")
    expect(field).to_have_value("45")


@pytest.mark.soak
def test_focus_stays_in_the_row_that_was_written(shared_page: OpensPages, holder: httpx.Client) -> None:
    holder.post("/api/v1/buses/line/control/hand-over", json={"to": "engineer"})
    page = opened(shared_page("engineer", viewport=PANEL), "/units/line/2/parameters")
    row = page.locator("#parameter-6")
    focus(row.locator("[name=value]"))
    page.keyboard.type("12.5")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Cancel")).to_be_focused()
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    expect(page.locator("[data-review-done=good]")).to_be_visible()
    expect(page.locator("dialog[open]")).to_have_count(0)
    expect(row.locator("[name=value]")).to_be_focused()
    holder.post("/api/v1/buses/line/control/hand-over", json={"to": "admin-program"})


def test_focus_stays_on_the_button_that_reads_and_the_end_is_said(shared_page: OpensPages) -> None:
    page = opened(shared_page("engineer", viewport=PANEL), "/units/line/2/parameters")
    read = page.get_by_role("button", name="Read all parameters")
    focus(read)
    page.keyboard.press("Enter")
    expect(page.locator("#reading-done")).to_have_text("40 of 40 parameters were read.")
    expect(read).to_be_focused()


@pytest.mark.soak
def test_nothing_moves_with_reduced_motion(browser_page: OpensPages) -> None:
    page = opened(browser_page("viewer", viewport=PANEL, reduced_motion="reduce"), "/units/line/1")
    moving = "document.getAnimations().map(one => one.effect.target.className)"
    assert page.evaluate(moving) == []


@pytest.mark.soak
def test_a_token_is_copied_shown_once_and_revoked_after_a_confirmation(browser_page: OpensPages) -> None:
    page = browser_page("admin", locale=ENGLISH, permissions=["clipboard-read", "clipboard-write"])
    page.goto("/users")
    page.get_by_role("button", name="New token").click()
    page.locator("#field-token").fill("plc")
    page.get_by_role("button", name="Create the token").click()
    secret = page.locator("[data-token]").inner_text()
    page.get_by_role("button", name="Copy").click()
    expect(page.get_by_role("button", name="Copied")).to_be_visible()
    assert page.evaluate("navigator.clipboard.readText()") == secret
    page.reload()
    expect(page.locator("[data-token]")).to_have_count(0)
    revoke = page.get_by_role("button", name="Revoke the token: plc")
    revoke.click()
    expect(page.locator("#review")).to_contain_text("Never used")
    page.get_by_role("button", name="Cancel").click()
    revoke.click()
    page.get_by_role("button", name="Revoke plc").click()
    expect(revoke).to_have_count(0)


@pytest.mark.provokes("422")
def test_a_drawer_that_was_refused_opens_again_with_what_was_typed(shared_page: OpensPages) -> None:
    page = shared_page("admin")
    page.goto("/users")
    page.get_by_role("button", name="Add a user").click()
    page.locator("#field-password").fill("a good new one")
    page.locator("#add-user form").evaluate("form => form.requestSubmit()")
    name, refused = page.locator("#field-name"), page.locator("#add-user .field__error")
    expect(name).to_be_focused()
    expect(refused).to_have_text("Not sent: this field is empty.")
    name.fill("two words")
    expect(refused).to_have_count(0)
    page.get_by_role("button", name="Add the user").click()
    expect(page.locator("#add-user [role=alert]")).to_be_visible()
    expect(name).to_have_value("two words")


def test_a_drawer_takes_the_focus_and_closes_when_it_leaves(shared_page: OpensPages) -> None:
    page = shared_page("admin")
    page.goto("/users")
    drawer = page.get_by_role("dialog", name="Add a user")
    page.get_by_role("button", name="Add a user").press("Enter")
    expect(drawer.locator(":focus")).to_have_count(1)
    drawer.get_by_label("Name").fill("karin")
    drawer.get_by_role("button", name="Add the user").focus()
    page.keyboard.press("Tab")
    expect(drawer).to_be_hidden()
    page.get_by_role("button", name="Add a user").press("Enter")
    expect(drawer.get_by_label("Name")).to_have_value("karin")


def test_a_page_whose_person_logged_out_elsewhere_leads_to_the_login_page(
    browser_page: OpensPages,
) -> None:
    page = opened(browser_page("operator", viewport=PANEL), "/units/line/3")
    page.evaluate("void fetch('/logout', { method: 'POST' })")
    page.wait_for_url("**/login?next=/units/line/3")
    expect(page.locator(".main")).not_to_contain_text("button")
