"""Languages: one file each, chosen by the person, then the browser, then the site; locales without the rest
of Babel."""

from __future__ import annotations

import asyncio
from datetime import date
from pathlib import Path

import httpx
import pytest
from babel import UnknownLocaleError, core, localedata
from babel.dates import format_date

from app.core.messages import Languages
from app.core.messages.languages import locale_of
from app.core.web import feature
from app.core.web.access import Role
from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.templating import Templates
from app.settings import Site
from tests.app.complete_app import House
from tests.for_each import for_each


@for_each(
    ("requested", "accepted", "otherwise", "chosen"),
    [
        ("", "", "en", "en"),
        ("", "", "de", "de"),
        ("", "de-AT,de;q=0.9,en;q=0.8", "en", "de"),
        ("", "fr,en;q=0.5,de;q=0.9", "en", "de"),
        ("", "fr", "de", "de"),
        ("", "DE", "en", "de"),
        ("", "de;q=nonsense, ,;;q=", "en", "en"),
        ("en", "de", "de", "en"),
        ("xx", "de", "en", "de"),
    ],
)
def test_which_language(requested: str, accepted: str, otherwise: str, chosen: str) -> None:
    assert Languages().choose(requested, accepted, otherwise).tag == chosen


async def test_the_browsers_language_and_then_ones_own(house: House) -> None:
    german = {"accept-language": "de"}
    client = await house.signed_in(Role.VIEWER)
    assert '<html lang="de"' in (await client.get("/account", headers=german)).text
    await client.post("/account/language", data={"language": "en"})
    assert '<html lang="en"' in (await client.get("/account", headers=german)).text
    await client.post("/account/language", data={"language": ""})
    assert '<html lang="de"' in (await client.get("/account", headers=german)).text


async def test_a_language_that_is_not_there(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    response: httpx.Response = await client.post("/account/language", data={"language": "../x"})
    assert response.status_code == 422


@pytest.fixture(autouse=True)
def _without_cache() -> None:
    locale_of.cache_clear()


def test_it_writes_dates_and_names_its_language() -> None:
    locale = locale_of("de")
    assert format_date(date(2026, 11, 26), "medium", locale=locale) == "26.11.2026"
    assert locale.languages["de"] == "Deutsch"


def test_nothing_else_stays_in_memory() -> None:
    locale = locale_of("en_GB")
    assert (localedata._cache, core._global_data) == ({}, None)
    with pytest.raises(KeyError):
        _ = locale.unit_display_names
    assert locale_of.__wrapped__("en_GB").number_symbols == locale.number_symbols


def test_a_locale_is_read_once() -> None:
    assert locale_of("de") is locale_of("de")


def test_an_unknown_one_is_refused() -> None:
    with pytest.raises(UnknownLocaleError):
        locale_of("xx")


def test_catalogs_are_compiled_before_a_page_needs_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feature, "AFTER_S", 0.0)
    templates = Templates(templates_dir(), Assets(static_dir()), Site(), kept_in=tmp_path)
    asyncio.run(feature.read_languages(templates, "de"))
    assert "catalog" in vars(templates.languages["de"])
    kept = {path.name for path in tmp_path.iterdir()}
    assert kept == {f"{each.locale}.mo" for each in templates.languages}
