"""A real browser on a real server on simulated units.

``line_server`` starts sites, ``site`` is one of eight units that a module shares, ``browser_page`` opens a
page signed in as a role, ``axe`` judges a page's accessibility.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import pytest
from playwright.sync_api import (
    Browser,
    BrowserContext,
    Error,
    Locator,
    Page,
    ViewportSize,
    expect,
    sync_playwright,
)

from app.cli.past import write_past
from app.settings import load
from bus.simulator.plant import demo_line
from tests.e2e import site as sites
from tests.e2e.limits import PAGE_MS, PAGE_S
from tests.e2e.pages import FITTED
from tests.e2e.site import AT_REST, PASSWORD, Site, eventually
from tests.free_port import free_port

CHROMIUM = "/usr/bin/chromium-headless-shell"
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
AXE = Path(__file__).resolve().parents[2] / "node_modules" / "axe-core" / "axe.min.js"
expect.set_options(timeout=PAGE_MS)
REQUEST_FAILED = ("Failed to load resource", "An unknown error occurred when fetching the script.")
"""In Chromium's words. The script is the service worker's, requested after the page was opened: where a test
stops the server or the network at once, the request fails. That it is served is tested in test_kiosk.
"""
AXE_RUN = """async ([part, options]) => (await axe.run(part, options)).violations.flatMap(broken =>
    broken.nodes.map(node => `${broken.id} (${broken.help}): ${node.html.slice(0, 200)}`))"""
"""Only violations leave the page: the complete report of axe is megabytes."""
ENGLISH, GERMAN = "en-GB", "de-DE"
SIZES = ((360, 740), (1280, 800), (1920, 1080))
SCHEMES: dict[str, tuple[Literal["light", "dark"], ...]] = {
    ENGLISH: ("dark", "light", "dark"),
    GERMAN: ("light", "dark", "light"),
}
PANEL_PX = 1280
DEFAULT_SIZE: ViewportSize = {"width": 1280, "height": 720}
FORGETS_TAPS = """addEventListener(
  "click", () => sessionStorage.removeItem("lineside-last-tap"), { capture: true });"""
"""A test presses faster than a person. On a machine that is quick enough, a press near the place of the one
before would be a second tap, and do nothing (js/second-tap.js)."""
TOO_WIDE = "document.documentElement.scrollWidth > document.documentElement.clientWidth"
UNCOVERED = """() => {
  const bars = document.querySelectorAll(".setpoints__act, .buttons--near");
  for (const bar of bars) bar.style.position = "static";
  scrollTo(0, 0);
}"""
"""What stays at the edge while a page is scrolled covers a part of a row, wherever that is."""
AXE_LOOKS = ["color-contrast", "target-size"]
"""What depends on colors and sizes."""
AXE_RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]


class OpensPages(Protocol):
    """``browser_page("operator", viewport={"width": 360, "height": 740})``; no role: not signed in. ``taps``:
    on the page a second tap does nothing, as for a person.
    """

    def __call__(self, role: str | None = ..., site: Site | None = ..., **context: Any) -> Page: ...


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Report of a test that failed what each page showed then, and what the server logged last."""
    report = yield
    used: dict[str, Any] = getattr(item, "funcargs", {})
    browser: Browser | None = used.get("browser")
    if call.when == "call" and report.failed and browser:
        for served in (value for value in used.values() if isinstance(value, Site)):
            report.sections.append((f"log of {served.url}", served.last_logged()))
        for page in (page for context in browser.contexts for page in context.pages):
            with suppress(Error):
                report.sections.append((f"page {page.url}", page.locator("body").inner_text(timeout=5000)))
    return report


@pytest.fixture(scope="session")
def ports() -> list[int]:
    """Ports of sites that have ended. The next site takes one of them, so that a page that is kept has its
    scripts and styles already."""
    return []


@pytest.fixture(scope="module")
def line_server(tmp_path_factory: pytest.TempPathFactory, ports: list[int]) -> Iterator[Callable[..., Site]]:
    """Starts sites: ``line_server(units=4, line_options=AT_REST, toml="…")``."""
    with ExitStack() as stack:

        def start(units: int = 8, **options: Any) -> Site:
            port = ports.pop() if ports else free_port()
            stack.callback(ports.append, port)
            folder = tmp_path_factory.mktemp("site")
            # While a unit ramps, server and page draw each of its values.
            return stack.enter_context(sites.site(folder, units, port=port, **{"ramp_s": 2, **options}))

        yield start


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Return eight units that only the test operates."""
    return line_server(8, line_options=AT_REST)


@pytest.fixture(scope="module")
def past_site(line_server: Callable[..., Site]) -> Site:
    """Twelve units with the past of the demo."""
    units = 12
    made = line_server(units)
    made.stop()
    # The browser's event loop runs in this thread.
    with ThreadPoolExecutor(1) as threads:
        threads.submit(write_past, load(made.config), demo_line(units)).result()
    made.start()
    made.wait_for_units()
    return made


def browser_scope(*, fixture_name: str, config: pytest.Config) -> Literal["session", "module"]:  # noqa: ARG001
    """One browser for all tests of a run of tests/e2e, or of a process that runs these alone, until it is
    done with them. Elsewhere one per module, because the event loop of Playwright, which runs until it is
    closed, is in the way of asynchronous tests."""
    has_pools = len(config.getoption("processes")) > 1
    return "session" if has_pools or all("tests/e2e" in each for each in config.args) else "module"


@pytest.fixture(scope=browser_scope)
def browser() -> Iterator[Browser]:
    """Chromium of the machine, without a window."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture
def browser_page(browser: Browser, request: pytest.FixtureRequest) -> Iterator[OpensPages]:
    """Opens pages signed in as a role; whatever a page logs as an error fails the test at its end.

    Mark a test with ``provokes("part of the text")`` where it means that.
    """
    complaints: list[str] = []
    with ExitStack() as stack:

        def open_page(role: str | None = "operator", site: Site | None = None, **context: Any) -> Page:
            page = new_page(browser, site or request.getfixturevalue("site"), role, complaints, context)
            stack.callback(page.context.close)
            return page

        yield open_page
    provoked = request.node.get_closest_marker("provokes")
    allowed: tuple[str, ...] = provoked.args if provoked else ()
    assert [text for text in complaints if not any(part in text for part in allowed)] == []


@dataclass
class KeptPage:
    """A page between two tests, and the errors that it has logged."""

    page: Page
    complaints: list[str]

    def reset(self) -> None:
        """Leave nothing of a test, and draw nothing until the next."""
        self.page.mouse.move(0, 0)
        self.page.goto("/healthz", wait_until="commit")
        self.page.evaluate("localStorage.clear(); sessionStorage.clear()")


@pytest.fixture(scope=browser_scope)
def kept_pages(browser: Browser) -> Iterator[dict[str, KeptPage]]:
    """The pages of ``shared_page``, by address and context."""
    assert browser.is_connected()
    pages: dict[str, KeptPage] = {}
    yield pages
    for kept in pages.values():
        kept.page.context.close()


@pytest.fixture
def shared_page(
    browser: Browser, kept_pages: dict[str, KeptPage], request: pytest.FixtureRequest
) -> Iterator[OpensPages]:
    """As ``browser_page``, but the next test may get the same page again, once it has been reset, in another
    size and role: a new page is a new process that loads and compiles everything, which takes as long again
    as the load. For tests that add no routes, scripts or clock to it.
    """
    used: dict[str, KeptPage] = {}

    def open_page(role: str | None = "operator", site: Site | None = None, **context: Any) -> Page:
        served: Site = site or request.getfixturevalue("site")
        context = {"locale": ENGLISH, **context}
        size = context.pop("viewport", DEFAULT_SIZE)
        kind = repr((served.url, sorted(context.items())))
        assert kind not in used, "a second page of this kind in one test: use browser_page"
        if kind not in kept_pages:
            complaints: list[str] = []
            kept_pages[kind] = KeptPage(new_page(browser, served, None, complaints, context), complaints)
        used[kind] = kept_pages.pop(kind)
        page = used[kind].page
        page.set_viewport_size(size)
        page.emulate_media(color_scheme="light", media="null")
        sign_in(page, served, role)
        return page

    yield open_page
    complaints = [text for kept in used.values() for text in kept.complaints]
    for kind, kept in used.items():
        kept.reset()
        kept.complaints.clear()
        kept_pages[kind] = kept
    assert complaints == []


def new_page(
    browser: Browser, served: Site, role: str | None, complaints: list[str], context: dict[str, Any]
) -> Page:
    """Return a page in a new context; the errors that it logs are added to ``complaints``."""
    state = signed_in(browser, served, role) if role else None
    # Without a graphics card, what moves for no reason but its looks is most of a test's time. The service
    # worker, the subject of test_kiosk, handles each request a second time.
    context = {"reduced_motion": "reduce", "service_workers": "block", "taps": False, **context}
    taps = context.pop("taps")
    opened = browser.new_context(base_url=served.url, storage_state=state, **context)
    if not taps:
        opened.add_init_script(FORGETS_TAPS)
    opened.set_default_timeout(PAGE_MS)
    page = opened.new_page()
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text) if is_complaint(message) else None)
    return page


def is_complaint(message: Any) -> bool:
    """An error or a broken content policy; a failed request is the page's business, not the console's."""
    return message.type == "error" and not any(words in message.text for words in REQUEST_FAILED)


def sign_in(page: Page, site: Site, role: str | None) -> None:
    """Give a page the cookies of a role, and no other; those of no role: none."""
    page.context.clear_cookies()
    if role:
        assert page.context.browser is not None
        page.context.add_cookies(signed_in(page.context.browser, site, role)["cookies"])


def signed_in(browser: Browser, site: Site, role: str) -> Any:
    """Return the cookies of a role, requested once for each site: signing in is slow on purpose."""
    if role not in site.sessions:
        context: BrowserContext = browser.new_context(base_url=site.url)
        response = context.request.post(
            "/login", form={"name": role, "password": PASSWORD}, headers={"Origin": site.url}, max_redirects=0
        )
        assert response.status in (200, 204, 303), (
            f"{role} could not sign in: {response.status} {response.text()}"
        )
        site.sessions[role] = context.storage_state()
        context.close()
    return site.sessions[role]


def focus(field: Locator) -> None:
    """Put the focus on a field; a unit that is stale for a moment has none to type into."""

    def has_focus() -> bool:
        field.focus()
        return bool(field.evaluate("field => field === document.activeElement"))

    eventually(has_focus, "a field to type into", within=PAGE_S)


@pytest.fixture(scope="session")
def axe() -> Callable[..., list[str]]:
    """``axe(page)`` → each violation in words; evaluated, as a script tag is blocked by the policy. ``part``:
    a selector of what is new on a page that is judged as a whole elsewhere.
    """
    source = AXE.read_text(encoding="utf-8")

    def judge(page: Page, *disabled: str, only: Sequence[str] = AXE_RULES, part: str = "html") -> list[str]:
        if not page.evaluate("'axe' in window"):
            page.evaluate(source)
        options = {
            "runOnly": only,
            "rules": {rule: {"enabled": False} for rule in disabled},
            "resultTypes": ["violations"],
            "selectors": False,
            # Would read all style sheets again, for a rule about audio.
            "preload": False,
        }
        found: list[str] = page.evaluate(AXE_RUN, [part, options])
        return found

    return judge


@pytest.fixture
def flaws(axe: Callable[..., list[str]]) -> Callable[..., list[str]]:
    """``flaws(page, locale)`` → what is wrong with an open page at each size: violations, and too wide.

    English and German together see the two lower sizes in light and in dark, and each of them once with all
    rules: the other time with those of colors and sizes. On the wall no color differs from a panel
    (tests/app/test_styles.py), and what is there does not depend on the language: axe judges it in English
    and without contrast, which is half of its time.
    """

    def judge(page: Page, locale: str = ENGLISH) -> list[str]:
        found = []
        for (width, height), scheme in zip(SIZES, SCHEMES[locale], strict=True):
            page.set_viewport_size({"width": width, "height": height})
            page.emulate_media(color_scheme=scheme)
            page.evaluate(FITTED)
            # A target that is half scrolled under the bar at the edge is not too small.
            page.evaluate(UNCOVERED)
            wrong = ["too wide"] if page.evaluate(TOO_WIDE) else []
            if width <= PANEL_PX:
                wrong += axe(page, only=AXE_RULES if scheme == "dark" else AXE_LOOKS)
            elif locale == ENGLISH:
                wrong += axe(page, "color-contrast")
            found += [f"{width} px, {scheme}: {each}" for each in wrong]
        return found

    return judge
