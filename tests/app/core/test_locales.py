"""app.core.messages.languages."""

from __future__ import annotations

from datetime import date

import pytest
from babel import UnknownLocaleError, core, localedata
from babel.dates import format_date

from app.core.messages.languages import locale_of


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
