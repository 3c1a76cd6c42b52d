"""What people see while the database is away, in a browser: the notice, what works, what is refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from app.cli.serving import awaiting
from app.database.settings import StoreSettings
from tests.app.test_awaiting import Away, settings_of, waiting
from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.site import AT_REST, Site, eventually
from tests.e2e.site import site as one_site
from tests.own_postgresql import OwnPostgresql, own_postgresql
from tests.postgresql import needs_postgresql

pytestmark = needs_postgresql
PAGES = ("/alarms", "/units/line/1")
NOTICE = "[data-live='line_summary.away']"


@pytest.fixture(scope="module")
def postgresql() -> Iterator[OwnPostgresql]:
    with own_postgresql() as made:
        yield made


@pytest.fixture(scope="module")
def site(postgresql: OwnPostgresql, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    store = StoreSettings(url=postgresql.url)
    with one_site(tmp_path_factory.mktemp("site"), 2, line_options=AT_REST, store=store) as made:
        yield made


def opened(page: Page, path: str) -> Page:
    page.goto(path)
    expect(page.locator("body[data-link=live]")).to_be_attached()
    return page


@pytest.mark.soak
@pytest.mark.provokes("503")
def test_an_open_page_states_it_and_what_still_works(
    site: Site, postgresql: OwnPostgresql, browser_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    english, german = browser_page(locale=ENGLISH), browser_page(locale=GERMAN)
    for page in (english, german):
        expect(opened(page, "/").locator(NOTICE)).to_be_empty()
    postgresql.kill()
    try:
        expect(english.locator(NOTICE)).to_contain_text("The database is away since")
        expect(english.locator(NOTICE)).to_contain_text("set line to zero and lower speeds")
        expect(german.locator(NOTICE)).to_contain_text("Datenbank")
        for page, locale in ((english, ENGLISH), (german, GERMAN)):
            assert flaws(page, locale) == []
        for path in PAGES:
            expect(opened(english, path).locator(NOTICE)).to_be_visible()
        with site.api("operator") as client:
            assert client.post("/buses/line/units/1/speed", json={"raw": 0, "execute": True}).is_success
    finally:
        postgresql.start()
    expect(english.locator(NOTICE)).to_be_empty()
    expect(german.locator(NOTICE)).to_be_empty()
    eventually(lambda: _followed(site), "the stop came into the audit log")
    opened(english, "/trends?s=line/1/actual")
    expect(english.locator("#trend-events")).to_contain_text("are being stored")


@pytest.mark.provokes("503")
def test_a_page_before_the_database_is_there(
    tmp_path: Path, browser: Browser, flaws: Callable[..., list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    away = Away()
    monkeypatch.setattr(awaiting, "look_at", away.look_at)
    monkeypatch.setattr(awaiting, "RETRY_S", 0.01)
    with waiting(settings_of(tmp_path), away) as port, browser.new_context(locale=GERMAN) as context:
        page = context.new_page()
        page.goto(f"http://127.0.0.1:{port}/wallboard")
        expect(page.get_by_role("main")).to_contain_text("Die Datenbank antwortet nicht.")
        assert flaws(page, GERMAN) == []


def _followed(site: Site) -> bool:
    with site.api("viewer") as client:
        response = client.get("/events", params={"kind": "command", "limit": 1})
    return response.status_code == 200 and response.json()["events"][0]["entered_at"] is not None
