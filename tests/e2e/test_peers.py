"""The lines of two servers in one browser: one of the servers dies and returns."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import expect

from tests.e2e.conftest import GERMAN, OpensPages
from tests.e2e.pages import opened
from tests.e2e.site import AT_REST, Site


@pytest.fixture(scope="module")
def peer(line_server: Callable[..., Site]) -> Site:
    return line_server(2, line_options=AT_REST)


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site], peer: Site, tmp_path_factory: pytest.TempPathFactory) -> Site:
    """A server with a line, and the other as its peer."""
    token = tmp_path_factory.mktemp("peer") / "mill2.token"
    token.write_text(peer.tokens["viewer"])
    toml = f'[[peer]]\nname = "Werk 2"\nurl = "{peer.url}"\ntoken_file = "{token}"\n'
    return line_server(2, line_options=AT_REST, toml=toml)


@pytest.mark.soak
def test_a_peer_that_dies_costs_its_tile_and_returns(
    site: Site, peer: Site, browser_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    page = opened(browser_page("viewer", site, locale=GERMAN), "/lines")
    own = page.locator("[data-line='line_of/line']")
    other = page.locator("[data-line^='line_of/1/']")
    expect(other.locator(".fleet__counts")).to_contain_text("2/2 aktuell")
    expect(other.get_by_role("link")).to_have_attribute("href", re.compile(re.escape(peer.url)))
    peer.stop()
    expect(other).to_have_attribute("data-quality", "stale")
    expect(other.locator(".fleet__text")).to_contain_text("keine Meldung von Werk 2")
    expect(own).to_have_attribute("data-quality", "live")
    assert flaws(page, GERMAN) == []
    peer.start()
    expect(other).to_have_attribute("data-quality", "live")
