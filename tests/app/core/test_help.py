"""The handbook: each chapter is there, each link leads to one, and what is written is found."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import pytest

from app.core.help.feature import calls_of
from app.core.help.handbook import BY_NAME, CHAPTERS, MAX_FOUND, Chapter, Handbook, Rendered, render, slug
from app.core.web.access import Role
from app.core.web.templating import HELP
from docs import site
from tests.app.complete_app import House
from tests.for_each import for_each
from tests.test_architecture import ROOT

LANGUAGES = ("en", "de")
PLAIN = CHAPTERS[0]


@pytest.fixture(scope="module")
def handbook() -> Handbook:
    return Handbook(ROOT / "docs")


def hrefs(html: str) -> list[str]:
    return re.findall(r'<a href="([^"]*)"', html)


def verbatim_of(chapter: Rendered) -> list[str]:
    """The commands and files of a chapter, and the cells with nothing but a number."""
    return re.findall(r"<pre.*?</pre>|<td>[\d.]+</td>", chapter.html, re.DOTALL)


@for_each(("chapter", "language"), product(CHAPTERS, LANGUAGES))
def test_every_link_of_a_chapter_leads_to_a_heading(
    handbook: Handbook, chapter: Chapter, language: str
) -> None:
    rendered = handbook.chapter(chapter, language)
    assert rendered.html.startswith(f'<h1 id="{rendered.sections[0].anchor}">')
    for href in hrefs(rendered.html):
        if href.startswith(("http://", "https://")):
            continue
        path, _, anchor = href.partition("#")
        led_to = handbook.chapter(BY_NAME[path.removeprefix("/help/")] if path else chapter, language)
        assert anchor in {"", *(section.anchor for section in led_to.sections)}, href


@for_each("chapter", [chapter for chapter in CHAPTERS if chapter.languages])
def test_a_translation_has_every_heading_and_link(handbook: Handbook, chapter: Chapter) -> None:
    english = handbook.chapter(chapter, "en")
    for language in chapter.languages:
        translated = handbook.chapter(chapter, language)
        assert [each.anchor for each in translated.sections] == [each.anchor for each in english.sections]
        assert translated.title != english.title
        assert verbatim_of(translated) == verbatim_of(english)
        assert sorted(hrefs(translated.html)) == sorted(hrefs(english.html))


def cells_of(chapter: Rendered) -> list[list[str]]:
    """Each row of four cells of the tables of a chapter."""
    rows = re.findall(r"<tr>.*?</tr>", chapter.html, re.DOTALL)
    return [cells for row in rows if len(cells := re.findall(r"<td>(.*?)</td>", row)) == 4]


def test_the_german_glossary_has_the_terms_of_the_english_one(handbook: Handbook) -> None:
    english, german = [cells_of(handbook.chapter(BY_NAME["glossary"], tag)) for tag in LANGUAGES]
    in_english = [(term, on_screen, code) for _, code, on_screen, term in english if term]
    assert in_english == [(term, on_screen, code) for term, _, on_screen, code in german]


@for_each("place", sorted(HELP.values()))
def test_the_help_of_a_page_exists(handbook: Handbook, place: str) -> None:
    name, _, anchor = place.partition("#")
    sections = handbook.chapter(BY_NAME[name], "en").sections
    assert anchor in {"", *(section.anchor for section in sections)}


def test_every_guide_is_a_chapter() -> None:
    files = {chapter.file_in(language) for chapter, language in product(CHAPTERS, LANGUAGES)}
    written = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs" / "guide").glob("*.md")}
    assert written <= files


def test_what_was_typed_is_found_titles_first(handbook: Handbook) -> None:
    assert handbook.search("", "en") == handbook.search("  ", "en") == []
    assert handbook.search("xyzzy", "en") == []
    hits = handbook.search("golden set", "en")
    assert 0 < len(hits) <= MAX_FOUND
    assert "golden" in f"{hits[0].section.title} {hits[0].section.text}".casefold()
    assert handbook.search("OUTPUTS names", "en")[0].section.anchor == "a-unit"
    assert handbook.search("the line", "en")[0].section.title.casefold().count("the line")
    assert handbook.search("Bedienhoheit", "de")[0].section.href == "/help/operator#control"


async def test_the_list_says_which_chapters_are_in_english(house: House) -> None:
    client = await house.signed_in(Role.VIEWER)
    german, english = [
        (await client.get("/help", headers={"Accept-Language": tag})).text for tag in ("de", "en")
    ]
    assert 'lang="en">Metrics</a> <small class="quiet">auf Englisch</small>' in german
    assert ("Für Bediener</a></li>" in german, "in English" in english) == (True, False)


def test_markup_in_a_chapter_is_text() -> None:
    html = render(PLAIN, "# A\n\n<script>x</script> [b](javascript:y)", "").html
    assert "<script>" not in html
    assert "javascript" not in "".join(hrefs(html))


def test_links_pictures_and_tables() -> None:
    linked = "[b](../hardware.md#x) [c](../LICENSE) [d](#e)\n\n![p](../pictures/line.png)"
    html = render(PLAIN, f"# A & B\n\n{linked}\n\n|a||\n|-|-|\n|b|c|\n", "guide").html
    assert hrefs(html) == ["/help/hardware#x", "#e"]
    assert 'src="/help/pictures/line.png"' in html
    assert '<div class="table-wrap" tabindex="0"><table class="table">' in html
    assert "<th></th>" not in html
    assert slug("A & B") == "a--b"


def test_only_a_picture_of_the_handbook_is_served(handbook: Handbook) -> None:
    assert handbook.picture("line.png") is not None
    for name in ("../api.md", "none.png", "..%2fapi.md", ""):
        assert handbook.picture(name) is None


def test_a_chapter_without_its_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        Handbook(tmp_path).chapter(PLAIN, "en")


def test_the_reference_lists_parameters_bodies_and_responses() -> None:
    integer = {"type": "integer"}
    document = {
        "components": {"schemas": {"Body": {"properties": {"raw": integer}, "required": ["raw"]}}},
        "paths": {
            "/b": {
                "post": {
                    "operationId": "set_b",
                    "tags": ["b"],
                    "parameters": [{"name": "n", "schema": {"anyOf": [integer, {"type": "null"}]}}],
                    "requestBody": {
                        "content": {
                            "x": {"schema": {"$ref": "#/components/schemas/Body"}, "example": {"raw": 4500}}
                        }
                    },
                    "responses": {"200": {"description": "Done", "content": {"y": {"example": "a line"}}}},
                }
            },
            "/a": {
                "get": {
                    "operationId": "get_a",
                    "tags": ["a"],
                    "parameters": [
                        {"name": "of", "schema": {"type": "array", "items": {"enum": ["x", "y"]}}},
                        {"name": "no", "schema": {"const": 1}, "required": True},
                    ],
                    "responses": {},
                }
            },
        },
    }
    (first, (get,)), (second, (post,)) = calls_of(document)
    assert (first, second) == ("a", "b")
    assert [(each.name, each.kind, each.is_required) for each in (*get.parameters, *post.body)] == [
        ("of", "array of x, y", False),
        ("no", "1", True),
        ("raw", "integer", True),
    ]
    assert post.parameters[0].kind == "integer or null"
    assert post.responses == (("200", "Done"),)
    assert (post.sent, post.received, get.sent, get.received) == ('{\n  "raw": 4500\n}', "a line", "", "")
    assert not get.can_open
    assert not post.can_open


def test_as_files_each_link_leads_to_one(tmp_path: Path) -> None:
    site.main(tmp_path / "site")
    pages = sorted((tmp_path / "site").glob("*.html"))
    assert len(pages) == 1 + sum(1 + len(chapter.languages) for chapter in CHAPTERS)
    for page in pages:
        led = re.findall(r'(?:href|src)="(?!https?:)([^"#]+)', page.read_text(encoding="utf-8"))
        assert [name for name in led if not (page.parent / name).is_file()] == [], page.name
