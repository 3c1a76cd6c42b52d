"""The languages that there are, and which of them a reader gets."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

from app.messages.language import Language

DEFAULT = "en"
FOLDER = Path(__file__).parent
LONGEST_HEADER = 400
"""Characters of Accept-Language that are read; browsers send a dozen tags at most."""


class Languages:
    """Every language there is a catalog for. ``kept_in``: where catalogs stay compiled from one start to the
    next."""

    def __init__(self, folder: Path = FOLDER, kept_in: Path | None = None) -> None:
        self._all = {tag: _language(path, kept_in) for tag, path in catalogs(folder).items()}

    def __iter__(self) -> Iterator[Language]:
        return iter(self._all.values())

    def __contains__(self, tag: object) -> bool:
        return tag in self._all

    def __getitem__(self, tag: str) -> Language:
        """The language, English for a tag there is no catalog for."""
        return self._all.get(tag) or self._all[DEFAULT]

    def choose(self, preferred: str, accept_language: str, otherwise: str) -> Language:
        """The person's own choice, else the browser's (RFC 9110, 12.5.4), else the site's."""
        if preferred in self._all:
            return self._all[preferred]
        for tag in _by_preference(accept_language):
            if tag in self._all:
                return self._all[tag]
        return self[otherwise]


def catalogs(folder: Path = FOLDER) -> dict[str, Path]:
    """Each language's tag and its catalog: ``en_GB.po`` is the catalog of ``en``."""
    return {path.stem.split("_")[0]: path for path in sorted(folder.glob("*.po"))}


@cache
def _language(path: Path, kept_in: Path | None) -> Language:
    """One for each file, so that a catalog is read once in a process."""
    return Language(path, kept_in)


def _by_preference(accept_language: str) -> list[str]:
    """``de-AT,de;q=0.9,en;q=0.8`` → ``["de-at", "de", "en"]``, each tag followed by its main part."""
    weighed: list[tuple[float, str]] = []
    for part in accept_language[:LONGEST_HEADER].split(","):
        tag, _, weight = part.strip().partition(";q=")
        try:
            weighed.append((float(weight or 1), tag.lower()))
        except ValueError:
            continue
    weighed.sort(key=lambda pair: -pair[0])
    return [each for _, tag in weighed for each in (tag, tag.split("-")[0])]
