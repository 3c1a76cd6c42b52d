"""The languages with their texts, by gettext, and how each writes numbers and dates, by Babel; and the time
zone of the machine, by a name that a browser understands too.

Only `locale_of` uses private members of Babel, for the 4.7 MiB that this saves (decision 20);
`pyproject.toml` bounds the version.
"""

from __future__ import annotations

import gettext
import hashlib
import os
import unicodedata
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import date, datetime, time, timedelta
from functools import cache, cached_property, lru_cache
from io import BytesIO
from pathlib import Path
from zoneinfo import ZoneInfo

from babel import Locale, core, localedata
from babel.localtime import get_localzone
from babel.numbers import get_decimal_symbol

from bus.instants import UnixTime
from bus.messages import TEXTS, Message, Plural

UTC = "UTC"
LOCALTIME = Path("/etc/localtime")
_FOLDER = "/zoneinfo/"
_SAME_ZONES = "posix/"
"""A folder that holds every zone a second time."""
_NOT_IANA = frozenset({"", "localtime", "posixrules", "Factory"})
"""Files of a zoneinfo folder that are no zones of the IANA list: browsers refuse their names."""


@cache
def machine_zone() -> str:
    """Return the IANA name of the machine's time zone (TZ, /etc/localtime, /etc/timezone), or UTC if it has
    none from the list, such as a TZ of POSIX rules. This is read once: a server keeps its zone."""
    try:
        found = get_localzone()
        # If pytz is installed, which asyncua needs, it is a zone of that: "local" by its file.
        name = getattr(found, "key", None) or getattr(found, "zone", None)
        if name in (None, "local"):
            # The path of its file gives the name of a zone: …/zoneinfo/Europe/Berlin.
            file = Path(os.environ.get("TZ", "").removeprefix(":") or LOCALTIME)
            name = str(file.resolve()).partition(_FOLDER)[2]
    except (LookupError, ValueError, OSError):
        return UTC
    name = name.removeprefix(_SAME_ZONES)
    return name if is_zone(name) else UTC


def is_zone(name: str) -> bool:
    """Return whether a name is in the IANA list, as far as this machine has it."""
    try:
        return name not in _NOT_IANA and ZoneInfo(name).key == name
    except (LookupError, ValueError, OSError):
        return False


def day_begins(text: str, zone: str, later: timedelta = timedelta(0)) -> UnixTime | None:
    """Return the instant at which a day (2026-11-21) begins at the site; None for an invalid day."""
    try:
        day = datetime.fromisoformat(text).date() + later
        return UnixTime(datetime.combine(day, time(), ZoneInfo(zone)).timestamp())
    except (ValueError, OverflowError):
        return None


_UNUSED = (
    *("compact_currency_formats", "compact_decimal_formats", "compound_unit_patterns", "currency_names"),
    *("currency_names_plural", "currency_symbols", "date_fields", "interval_formats", "meta_zones"),
    *("scripts", "territories", "time_zones", "unit_display_names", "unit_patterns", "variants"),
)


@cache
def locale_of(name: str) -> Locale:
    """Return the locale of a name such as ``en_GB``, without 4.7 MiB that Babel keeps of two locales:
    currencies, units, territories, and which language is likely where. Raise babel.UnknownLocaleError, and
    ValueError for a text that is no name."""
    locale = Locale.parse(name)
    _ = locale.number_symbols  # It is read here, and the locale keeps it.
    data = localedata.load(str(locale))
    for each in _UNUSED:
        data.pop(each, None)
    localedata._cache.clear()
    core._global_data = None
    return locale


def moment(at: datetime, locale: Locale) -> str:
    """Return date and time to the second."""
    return f"{day(at, locale)}, {at:%H:%M:%S}"


def minute(at: datetime, locale: Locale) -> str:
    """Return date and time to the minute."""
    return f"{day(at, locale)}, {at:%H:%M}"


def day(at: datetime, locale: Locale) -> str:
    """Return the date."""
    return _day(at.date(), locale)


@lru_cache(100)
def _day(day: date, locale: Locale) -> str:
    # Imported here, because it takes long, and the command line shows no dates.
    from babel.dates import format_date

    return format_date(day, "medium", locale=locale)


class Language:
    """The texts of one language. ``path``: its catalog, named after the locale for numbers and dates, which
    is read with the first text. ``time_zone``: that of the site, by its IANA name."""

    def __init__(self, path: Path, kept_in: Path | None = None, time_zone: str = UTC) -> None:
        self.locale = path.stem
        self.tag = self.locale.split("_")[0]
        self._path = path
        self._kept_in = kept_in
        self._time_zone = time_zone

    def __str__(self) -> str:
        return self.tag

    def t(self, text: str | Message, /, **values: object) -> str:
        """Return a text in this language, in English if it is not translated, with ``{names}`` filled in."""
        if isinstance(text, Message):
            return text.render(self)
        text = self.term(text)
        return text.format(**self._isolated(values)) if values else text

    def tn(self, one: str, many: str, n: int, /, **values: object) -> str:
        """Return the text for a count: ``one`` for exactly one, else ``many`` (as this language divides
        them); ``{n}`` in it is the count."""
        return self.catalog.ngettext(one, many, n).format(n=n, **self._isolated(values))

    def term(self, text: str) -> str:
        """Return a text of the catalog in this language; unchanged if there is no translation."""
        return self.catalog.gettext(text) if text else ""

    def time(self, text: str) -> str:
        """Return a date or a time in ISO 8601 by the clock of the site; one without a zone is by that clock
        already. Any other text is returned unchanged."""
        locale = locale_of(self.locale)
        try:
            at = datetime.fromisoformat(text)
            if len(text) == len("2026-11-26"):
                return day(at, locale)
            if at.tzinfo is None:
                return minute(at, locale)
            return moment(at.astimezone(ZoneInfo(self._time_zone)), locale)
        except (ValueError, OverflowError):
            return text

    def isolated(self, text: str) -> str:
        """Return a name unchanged: in mail, CSV and the API, programs compare names."""
        return text

    def _isolated(self, values: Mapping[str, object]) -> dict[str, object]:
        """Isolate each text; markup is isolated by its elements."""
        return {name: self.isolated(value) if type(value) is str else value for name, value in values.items()}

    @cached_property
    def on_screen(self) -> Language:
        """This language for pages, and for texts that a script shows on them."""
        return _OnScreen(self)

    def template(self, code: str, n: object) -> str | None:
        """Return the text of a message, its names in braces; None if there is no such code."""
        english = TEXTS.get(code)
        if isinstance(english, Plural):
            count = n if isinstance(n, int) else 0
            return self.catalog.npgettext(code, english.one, english.many, count)
        return english and self.catalog.pgettext(code, english)

    def read(self) -> None:
        """Read the catalog now, in any thread, rather than with the first text."""
        _ = self.catalog

    def compile(self) -> None:
        """Keep the catalog compiled, so that it is read within milliseconds with the first text."""
        compiled(self._path, self._kept_in)

    @cached_property
    def name(self) -> str:
        """The name of the language in this language."""
        return str(locale_of(self.locale).languages.get(self.tag, self.tag))

    @cached_property
    def point(self) -> str:
        """The decimal sign of the language."""
        return get_decimal_symbol(locale_of(self.locale))

    @cached_property
    def catalog(self) -> gettext.GNUTranslations:
        return compiled(self._path, self._kept_in)


FIRST_STRONG_ISOLATE, POP_DIRECTIONAL_ISOLATE = "\u2068", "\u2069"
"""Characters around a text whose own letters decide its direction, as ``<bdi>`` does (Unicode Annex 9). They
also work in titles, in attributes and in texts that a script shows."""
_FROM_RIGHT_TO_LEFT = frozenset(("R", "AL"))


class _OnScreen(Language):
    """A language whose texts isolate each name with letters from right to left."""

    def __init__(self, plain: Language) -> None:
        super().__init__(plain._path, plain._kept_in, plain._time_zone)
        self._plain = plain

    def isolated(self, text: str) -> str:
        """Return a text between isolates if it has such letters; no other character changes."""
        if text.isascii() or _FROM_RIGHT_TO_LEFT.isdisjoint(map(unicodedata.bidirectional, text)):
            return text
        return f"{FIRST_STRONG_ISOLATE}{text}{POP_DIRECTIONAL_ISOLATE}"

    @cached_property
    def catalog(self) -> gettext.GNUTranslations:
        return self._plain.catalog


DIGEST_BYTES = 32
"""The length of the digest of the source, which precedes the catalog compiled from it."""


def compiled(path: Path, kept_in: Path | None) -> gettext.GNUTranslations:
    """Return the catalog of a ``.po`` file. Parsing one takes a tenth of a second, so the result is kept in
    ``kept_in`` until the file changes. If that folder cannot be written, each start takes that time."""
    source = path.read_bytes()
    digest = hashlib.sha256(source).digest()
    kept = kept_in / f"{path.stem}.mo" if kept_in is not None else None
    if kept is not None:
        with suppress(OSError):
            data = kept.read_bytes()
            if data[:DIGEST_BYTES] == digest:
                return gettext.GNUTranslations(BytesIO(data[DIGEST_BYTES:]))
    data = _parsed(source, path.stem)
    if kept is not None:
        with suppress(OSError):
            kept.parent.mkdir(0o700, parents=True, exist_ok=True)
            unfinished = kept.with_suffix(".new")
            unfinished.write_bytes(digest + data)
            unfinished.replace(kept)
    return gettext.GNUTranslations(BytesIO(data))


def _parsed(source: bytes, locale: str) -> bytes:
    # Imported here because it takes as long as half a catalog.
    from babel.messages.mofile import write_mo
    from babel.messages.pofile import read_po

    target = BytesIO()
    # Without a locale, Babel leaves out the rule for plurals.
    write_mo(target, read_po(BytesIO(source), locale=locale))
    return target.getvalue()


DEFAULT = "en"
FOLDER = Path(__file__).parent
MAX_HEADER = 400
"""The most characters of Accept-Language that are read; browsers send a dozen tags at most."""


class Languages:
    """The languages that have a catalog. ``kept_in``: the folder of compiled catalogs between starts;
    ``time_zone``: that of the site."""

    def __init__(self, folder: Path = FOLDER, kept_in: Path | None = None, time_zone: str = UTC) -> None:
        self._all = {tag: _language(path, kept_in, time_zone) for tag, path in catalogs(folder).items()}

    def __iter__(self) -> Iterator[Language]:
        return iter(self._all.values())

    def __contains__(self, tag: object) -> bool:
        return tag in self._all

    def __getitem__(self, tag: str) -> Language:
        """Return the language, or English for a tag without a catalog."""
        return self._all.get(tag) or self._all[DEFAULT]

    def choose(self, preferred: str, accept_language: str, otherwise: str) -> Language:
        """Return the person's own choice, else the browser's (RFC 9110, 12.5.4), else the site's."""
        if preferred in self._all:
            return self._all[preferred]
        for tag in _by_preference(accept_language):
            if tag in self._all:
                return self._all[tag]
        return self[otherwise]


def catalogs(folder: Path = FOLDER) -> dict[str, Path]:
    """Return the catalog of each language, by its tag: ``en_GB.po`` is the catalog of ``en``."""
    return {path.stem.split("_")[0]: path for path in sorted(folder.glob("*.po"))}


_language = cache(Language)
"""A function that returns one language for each file, so that a process reads a catalog only once."""


def _by_preference(accept_language: str) -> list[str]:
    """Return the tags of ``de-AT,de;q=0.9,en;q=0.8``, each followed by its main part: ``["de-at", "de",
    "en"]``."""
    weighed: list[tuple[float, str]] = []
    for part in accept_language[:MAX_HEADER].split(","):
        tag, _, weight = part.strip().partition(";q=")
        try:
            weighed.append((float(weight or 1), tag.lower()))
        except ValueError:
            continue
    weighed.sort(key=lambda pair: -pair[0])
    return [each for _, tag in weighed for each in (tag, tag.split("-")[0])]
