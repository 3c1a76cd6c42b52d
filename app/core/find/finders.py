"""The finders of the search: each feature adds those of its things, and all search together. Names are
matched without case, accents and order of words."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from app.core.messages import Language
from app.core.web.formats import Formats
from bus.messages import Message

EXACT, BEGINS, WORD_BEGINS, WITHIN = range(4)
"""The ways in which a word is found in a name, the best first."""
_WORD = re.compile(r"\w+")
_HYPHENS = re.compile("[-\N{HYPHEN}]")


def folded(text: str) -> str:
    """Return a text without case and accents, so that "kuhl" finds "Kühlwalze"."""
    apart = unicodedata.normalize("NFKD", text.casefold())
    return "".join(letter for letter in apart if not unicodedata.combining(letter))


def words_of(typed: str) -> list[str]:
    """Return the words of a query, folded, each once."""
    return list(dict.fromkeys(_WORD.findall(folded(typed))))


def rank(words: Sequence[str], names: Iterable[str]) -> int | None:
    """Return how well all ``words`` are found in ``names``, 0 the best; None if one is in none of them. A
    number is found as a number: "2" is not in "12"."""
    among = [folded(name) for name in names if name]
    if " ".join(words) in among:
        return EXACT
    total = 0
    for word in words:
        found = [how for name in among if (how := _found(word, name)) is not None]
        if not found:
            return None
        total += min(found)
    return total


def missing(words: Iterable[str], names: Sequence[str]) -> list[str]:
    """Return the words that are in none of ``names``."""
    return [word for word in words if rank([word], names) is None]


def _found(word: str, name: str) -> int | None:
    if name == word:
        return EXACT
    if word.isdigit():
        return WORD_BEGINS if word in _WORD.findall(name) else None
    if name.startswith(word):
        return BEGINS
    if any(each.startswith(word) for each in _WORD.findall(name)):
        return WORD_BEGINS
    return WITHIN if word in name or word in _HYPHENS.sub("", name) else None


MAX_OF_KIND = 6
"""The most results of one kind that are shown, the best of them."""
Text = str | Message


@dataclass(frozen=True, slots=True)
class Search:
    """The search of a person. ``may``: whether this person may perform an act; ``near``: the path of the page
    where it was typed, whose unit comes first."""

    typed: str
    language: Language
    formats: Formats
    may: Callable[[str], bool]
    near: str = ""

    @property
    def words(self) -> list[str]:
        return words_of(self.typed)


class LiveBit(NamedTuple):
    """A bit that the page shows as it is at each moment: its ``unit``, its place in a live field, and the
    words for 1 and 0."""

    unit: str
    field: str
    on: str
    off: str


class FoundPlace(NamedTuple):
    """A thing that was found. ``label`` names it, ``detail`` states what or where it is; ``rank``: 0 is the
    best. ``is_name``: whether a person wrote the label, in any script. ``bit``: what ``detail`` states, for
    as long as the result is in sight."""

    label: Text
    href: str
    detail: Text = ""
    rank: int = 0
    is_name: bool = False
    bit: LiveBit | None = None


Finder = Callable[[Search], Awaitable[Iterable[FoundPlace]]]


class FixedPlace(NamedTuple):
    """A page or an action at a fixed address. ``act``: the act that a person must be permitted; ``words``:
    the code of more words that find it."""

    label: Message
    href: str
    act: str = ""
    words: Message | None = None


class FoundKind(NamedTuple):
    """The places of one kind that were found, the best first. ``more``: how many others were."""

    kind: Message
    places: Sequence[FoundPlace]
    more: int


class Finders:
    """The finders by the kind of their results, in the order in which kinds are shown."""

    def __init__(self) -> None:
        self._finders: dict[str, list[Finder]] = {}

    def add(self, kind: str, finder: Finder) -> None:
        """Add a finder of things of a kind; ``kind``: the code of its heading."""
        self._finders.setdefault(kind, []).append(finder)

    def add_links(self, kind: str, links: Sequence[FixedPlace]) -> None:
        """Add pages or actions, each found by those who may use it."""

        async def find(search: Search) -> Iterable[FoundPlace]:
            return _linked(links, search)

        self.add(kind, find)

    async def find(self, search: Search) -> list[FoundKind]:
        """Return the results of ``search``; nothing for a text without a letter or digit."""
        if not search.words:
            return []
        found = []
        for kind, finders in self._finders.items():
            places = [place for finder in finders for place in await finder(search)]
            if places:
                best = sorted(places, key=lambda place: place.rank)[:MAX_OF_KIND]
                found.append(FoundKind(Message(kind), best, len(places) - len(best)))
        return sorted(found, key=lambda of_kind: of_kind.places[0].rank)


def matched(search: Search, place: FoundPlace, *names: str) -> Iterator[FoundPlace]:
    """Yield ``place`` with its rank if the words of ``search`` are in ``names``."""
    how_well = rank(search.words, names)
    if how_well is not None:
        yield place._replace(rank=how_well)


def _linked(links: Iterable[FixedPlace], search: Search) -> Iterator[FoundPlace]:
    t = search.language.t
    for link in links:
        if not link.act or search.may(link.act):
            more = (t(link.words),) if link.words else ()
            yield from matched(search, FoundPlace(link.label, link.href), t(link.label), *more)
