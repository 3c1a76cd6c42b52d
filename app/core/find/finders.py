"""What can be found: each feature adds what finds its things, and they are looked for together."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from app.core.find.matching import rank, words_of
from app.core.messages import Language
from app.core.web.rendering.formats import Formats
from bus.messages import Message

MAX_OF_KIND = 6
"""How many things of a kind are shown; the best of them."""
Text = str | Message


@dataclass(frozen=True, slots=True)
class Search:
    """What a person looks for. ``may``: whether this person may perform an act; ``near``: the path of the
    page where it was typed, whose unit comes first."""

    typed: str
    language: Language
    formats: Formats
    may: Callable[[str], bool]
    near: str = ""

    @property
    def words(self) -> list[str]:
        return words_of(self.typed)


class FoundPlace(NamedTuple):
    """A thing that was found. ``label`` names it, ``detail`` is what or where it is; ``rank``: 0 is the best.
    ``is_name``: a label that a person wrote, of any script."""

    label: Text
    href: str
    detail: Text = ""
    rank: int = 0
    is_name: bool = False


Finder = Callable[[Search], Awaitable[Iterable[FoundPlace]]]


class FixedPlace(NamedTuple):
    """A page or an action at a fixed address. ``act``: what a person must be permitted to do; ``words``: the
    code of more words that find it."""

    label: Message
    href: str
    act: str = ""
    words: Message | None = None


class FoundKind(NamedTuple):
    """Places of one kind, the best first."""

    kind: Message
    places: Sequence[FoundPlace]


class Finders:
    """All finders, by the kind of what they find, in the order in which kinds are shown."""

    def __init__(self) -> None:
        self._finders: dict[str, list[Finder]] = {}

    def add(self, kind: str, finder: Finder) -> None:
        """``kind``: the code of its heading."""
        self._finders.setdefault(kind, []).append(finder)

    def add_links(self, kind: str, links: Sequence[FixedPlace]) -> None:
        """Pages or actions, each for those who may use it."""

        async def find(search: Search) -> Iterable[FoundPlace]:
            return _linked(links, search)

        self.add(kind, find)

    async def find(self, search: Search) -> list[FoundKind]:
        """What ``search`` finds; nothing for a text without a letter or digit."""
        if not search.words:
            return []
        found = []
        for kind, finders in self._finders.items():
            places = [place for finder in finders for place in await finder(search)]
            if places:
                best = sorted(places, key=lambda place: place.rank)[:MAX_OF_KIND]
                found.append(FoundKind(Message(kind), best))
        return sorted(found, key=lambda of_kind: of_kind.places[0].rank)


def matched(search: Search, place: FoundPlace, *names: str) -> Iterator[FoundPlace]:
    """``place`` with its rank, if the words of ``search`` are in ``names``."""
    how_well = rank(search.words, names)
    if how_well is not None:
        yield place._replace(rank=how_well)


def _linked(links: Iterable[FixedPlace], search: Search) -> Iterator[FoundPlace]:
    t = search.language.t
    for link in links:
        if not link.act or search.may(link.act):
            more = (t(link.words),) if link.words else ()
            yield from matched(search, FoundPlace(link.label, link.href), t(link.label), *more)
