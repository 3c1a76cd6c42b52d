"""A third language is one file: with its catalog alone, no page has a text in another language."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from babel.messages.catalog import Catalog

from app.core.messages import Languages
from app.core.messages.languages import DEFAULT, catalogs
from app.core.web.access import Role
from app.core.web.templating import Templates
from app.line.live.bus_live import LiveState
from bus.catalogue.parameters import PARAMETERS
from bus.contract import ParameterValue
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import snapshot
from tests.app.page_texts import PAGES, texts_without
from tests.catalogs import wanted, write

AS_THEY_ARE = {
    *(re.escape(name) for name in ("Mill 7", "Unwind", "Nip", "dry-end", "/dev/null", "m/min", "the-admin")),
    *(
        "REMOTE",
        "LOCAL",
        "KEYLOCK",
        "CSV",
        "Parquet",
        "Etc/UTC",
        "Deutsch",
        "English",
        "français",
        r"\d+ \w+\.? \d{4}",
        "test",
    ),
}
"""What the manual or the site calls something, and what has one name in every language."""
NAMES = re.compile("|".join(sorted(AS_THEY_ARE, key=len, reverse=True)))
MARKED = re.compile("⟦[^⟦⟧]*⟧")
WORD = re.compile(r"[^\W\d_]{3,}")


def not_of_the_catalog(page: str) -> Iterator[str]:
    """Texts with words outside of the marks that the catalog has put around each of its texts."""
    for text, left in texts_without(page, MARKED):
        if WORD.search(NAMES.sub("", left)):
            yield " ".join(text.split())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The catalogs, and one more file."""
    there = tmp_path_factory.mktemp("messages")
    english = catalogs()[DEFAULT]
    (there / english.name).write_bytes(english.read_bytes())
    marked = Catalog(locale="fr")
    for (code, _), text in wanted().items():
        plural = tuple(f"⟦{each}⟧" for each in text) if isinstance(text, tuple) else f"⟦{text}⟧"
        marked.add(text, plural, context=code)
    write(there / "fr.po", marked)
    return there


async def french(house: House) -> httpx.AsyncClient:
    bus = house.services[LiveState].buses["dry-end"]
    bus.connect_worker(snapshot())
    lowest = [ParameterValue(unit=1, number=n, at=1.7e9, raw=p.minimum) for n, p in PARAMETERS.items()]
    bus.apply([each for each in lowest if each.number % 2])
    client = await house.signed_in(Role.ADMIN)
    client.headers.update({"Accept-Language": "fr", "Accept": "text/html"})
    return client


async def test_no_page_has_a_text_outside_of_the_catalog(tmp_path: Path, folder: Path) -> None:
    async with complete_app(tmp_path) as house:
        house.services[Templates].languages = Languages(folder)
        reader = await french(house)
        pages = {path: (await reader.get(path, follow_redirects=True)).text for path in PAGES}
    assert [path for path, page in pages.items() if "⟦" not in page] == []
    found = {path: list(not_of_the_catalog(page)) for path, page in pages.items()}
    assert {path: texts for path, texts in found.items() if texts} == {}


def test_a_text_outside_of_the_catalog_is_found() -> None:
    page = '<p title="Not translated">⟦Unit {⟦x⟧}⟧ 12 raw <b>Unwind</b></p>'
    assert list(not_of_the_catalog(page)) == ["Not translated", "⟦Unit {⟦x⟧}⟧ 12 raw"]
