"""How numbers and dates are written, by Babel, without the rest of its data."""

from __future__ import annotations

from datetime import datetime
from functools import cache

from babel import Locale, core, localedata

_UNUSED = (
    *("compact_currency_formats", "compact_decimal_formats", "compound_unit_patterns", "currency_names"),
    *("currency_names_plural", "currency_symbols", "date_fields", "interval_formats", "meta_zones"),
    *("scripts", "territories", "time_zones", "unit_display_names", "unit_patterns", "variants"),
)


@cache
def locale_of(name: str) -> Locale:
    """Return the locale of a name such as ``en_GB``. Of two, Babel would keep 4 MiB in memory: currencies,
    units, territories, and which language is likely where. Raises babel.UnknownLocaleError, and ValueError
    for what is no name."""
    locale = Locale.parse(name)
    _ = locale.number_symbols  # it is read here, and the locale keeps it
    data = localedata.load(str(locale))
    for each in _UNUSED:
        data.pop(each, None)
    localedata._cache.clear()
    core._global_data = None
    return locale


def moment(at: datetime, locale: Locale) -> str:
    """Date and time to the second."""
    # Only here, as below, because importing it takes long, and the command line shows none.
    from babel.dates import format_datetime

    return format_datetime(at, "medium", locale=locale)


def minute(at: datetime, locale: Locale) -> str:
    """Date and time to the minute."""
    return f"{day(at, locale)}, {at:%H:%M}"


def day(at: datetime, locale: Locale) -> str:
    """The date."""
    from babel.dates import format_date

    return format_date(at.date(), "medium", locale=locale)
