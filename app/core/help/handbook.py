"""The chapters of the handbook, and their HTML: links between files become links between pages, and each
section can be found.

Each chapter is a Markdown file of docs/, which the repository shows as well as the page *Help*. The Markdown
library is imported with the first page of the handbook, because most servers never show one.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from markupsafe import Markup

from bus.messages import Message, term

LEARN, DO, LOOK_UP, UNDERSTAND = (
    term("Get started"),
    term("How to"),
    term("Reference"),
    term("Background"),
)


@dataclass(frozen=True, slots=True)
class Chapter:
    """A chapter. ``file``: below docs/; ``group``: its part of the list; ``languages``: those in which it is
    written besides English, each as a file ``name.LANGUAGE.md``."""

    file: str
    group: Message
    languages: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The end of the address of the chapter."""
        return str(PurePosixPath(self.file).with_suffix("")).removeprefix("guide/")

    @property
    def is_one_page(self) -> bool:
        """Whether the chapter is printed on one page."""
        return self.name.removesuffix("-page") in WITH_A_PAGE

    def file_in(self, language: str) -> str:
        """Return the file for a reader of this language."""
        return self.file.removesuffix(".md") + f".{language}.md" if language in self.languages else self.file


GERMAN = ("de",)
WITH_A_PAGE = ("operator", "electrician", "engineer", "administrator")
"""The roles that have a chapter of one page to print."""
CHAPTERS = (
    Chapter("guide/tutorial.md", LEARN, GERMAN),
    Chapter("guide/operator.md", LEARN, GERMAN),
    *(Chapter(f"guide/{role}-page.md", LEARN, GERMAN) for role in WITH_A_PAGE),
    Chapter("guide/troubleshooting.md", DO, GERMAN),
    Chapter("hardware.md", DO, GERMAN),
    Chapter("guide/recipes.md", DO, GERMAN),
    Chapter("guide/own-alarms.md", DO, GERMAN),
    Chapter("guide/reports.md", DO, GERMAN),
    Chapter("guide/replace-a-drive.md", DO, GERMAN),
    Chapter("guide/several-lines.md", DO, GERMAN),
    Chapter("guide/users.md", DO, GERMAN),
    Chapter("guide/company-accounts.md", DO, GERMAN),
    Chapter("guide/backup.md", DO, GERMAN),
    Chapter("spare.md", DO, GERMAN),
    Chapter("tls.md", DO, GERMAN),
    Chapter("containers.md", DO),
    Chapter("scale.md", DO),
    Chapter("plant-database.md", DO),
    Chapter("mqtt.md", DO),
    Chapter("opcua.md", DO),
    Chapter("configuration.md", LOOK_UP),
    Chapter("alarms.md", LOOK_UP, GERMAN),
    Chapter("guide/command-line.md", LOOK_UP),
    Chapter("api.md", LOOK_UP),
    Chapter("guide/metrics.md", LOOK_UP),
    Chapter("guide/protocol.md", LOOK_UP, GERMAN),
    Chapter("glossary.md", LOOK_UP, GERMAN),
    Chapter("safety.md", UNDERSTAND, GERMAN),
    Chapter("security.md", UNDERSTAND),
    Chapter("audit.md", UNDERSTAND),
    Chapter("architecture.md", UNDERSTAND),
)
BY_NAME = {chapter.name: chapter for chapter in CHAPTERS}
BY_FILE = {name: chapter for chapter in CHAPTERS for name in (chapter.file, *map(chapter.file_in, GERMAN))}


MAX_FOUND = 20
ENGLISH = "en"
AROUND = 80
"""The characters of a section that are shown before and after the first match."""
_PICTURES = "pictures/"
FITTED = (
    ("<pre>", '<pre tabindex="0">'),
    ("<table", '<div class="table-wrap" tabindex="0"><table'),
    ("</table>", "</table></div>"),
    ("<th></th>", "<td></td>"),
)
"""Replacements in the HTML: content wider than a phone scrolls, and the keyboard reaches it; a column without
a heading has none to read out."""


@dataclass(frozen=True, slots=True)
class HelpSection:
    """A heading with the text below it, up to the next heading. ``anchor``: that of the heading in its
    chapter."""

    chapter: Chapter
    title: str
    anchor: str
    text: str

    @property
    def href(self) -> str:
        return f"/help/{self.chapter.name}#{self.anchor}"


@dataclass(frozen=True, slots=True)
class Rendered:
    """A chapter in one language: its title, its HTML with that title, and its sections in order."""

    title: str
    html: Markup
    sections: tuple[HelpSection, ...]


@dataclass(frozen=True, slots=True)
class Hit:
    """A section with all words of a search, and the part of its text around the first word."""

    section: HelpSection
    excerpt: str


class Handbook:
    """The chapters of one folder, each rendered when it is first read."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.chapter = lru_cache(maxsize=2 * len(CHAPTERS))(self._chapter)
        self.titles = lru_cache(maxsize=8)(self._titles)

    def _chapter(self, chapter: Chapter, language: str) -> Rendered:
        file = chapter.file_in(language)
        text = (self._folder / file).read_text(encoding="utf-8")
        # A translation has the headings of the English chapter, in its order, under the same anchors.
        english = () if file == chapter.file else self.chapter(chapter, ENGLISH).sections
        return render(chapter, text, posixpath.dirname(file), [section.anchor for section in english])

    def _titles(self, language: str) -> list[tuple[Chapter, str]]:
        """Return each chapter with its title, the first line of its file, which is not rendered."""
        found = []
        for chapter in CHAPTERS:
            with (self._folder / chapter.file_in(language)).open(encoding="utf-8") as file:
                found.append((chapter, file.readline().removeprefix("# ").strip().replace("`", "")))
        return found

    def picture(self, name: str) -> Path | None:
        """Return a picture of the handbook; None if there is none of this name."""
        path = self._folder / _PICTURES / name
        return path if re.fullmatch(r"[\w-]+\.png", name) and path.is_file() else None

    def search(self, typed: str, language: str) -> list[Hit]:
        """Return the sections with all of these words, those with all of them in the title first."""
        words = typed.casefold().split()
        if not words:
            return []
        sections = (each for chapter in CHAPTERS for each in self.chapter(chapter, language).sections)
        found = [each for each in sections if _has_all(f"{each.title} {each.text}", words)]
        found.sort(key=lambda section: not _has_all(section.title, words))
        return [Hit(section, _excerpt(section, words)) for section in found[:MAX_FOUND]]


def render(chapter: Chapter, text: str, folder: str, anchors: Sequence[str] = ()) -> Rendered:
    """Render a chapter from its Markdown. ``folder``: that of its file below docs/, from which its links
    lead. ``anchors``: those of its headings, unless they are made from their words."""
    from markdown_it import MarkdownIt

    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = parser.parse(text)
    sections = tuple(_sections(chapter, tokens, iter(anchors)))
    for token in _all(tokens):
        if token.type == "link_open":
            _lead(token, folder)
        elif token.type == "image":
            token.attrSet("src", f"/help/{_PICTURES}{posixpath.basename(str(token.attrGet('src')))}")
            token.attrSet("loading", "lazy")
        elif token.type == "table_open":
            token.attrSet("class", "table")
    html = parser.renderer.render(tokens, parser.options, {})
    for before, after in FITTED:
        html = html.replace(before, after)
    return Rendered(sections[0].title, Markup(html), sections)


def slug(title: str) -> str:
    """Return the anchor of a heading, as the pages of the repository have it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def _all(tokens: Sequence[Any]) -> Iterator[Any]:
    for token in tokens:
        yield token
        yield from _all(token.children or ())


def _sections(chapter: Chapter, tokens: Sequence[Any], anchors: Iterator[str]) -> Iterator[HelpSection]:
    """Yield each section: a heading, which gets its anchor, with all text up to the next."""
    title, anchor, texts = "", "", list[str]()
    for before, token in zip((None, *tokens), tokens, strict=False):
        if token.type != "inline":
            if token.type in ("fence", "code_block"):
                texts.append(token.content)
            continue
        words = "".join(part.content or " " for part in token.children)
        if before is None or before.type != "heading_open":
            texts.append(words)
            continue
        if title:
            yield HelpSection(chapter, title, anchor, " ".join(texts))
        title, anchor, texts = words, next(anchors, slug(words)), []
        before.attrSet("id", anchor)
    yield HelpSection(chapter, title, anchor, " ".join(texts))


def _lead(token: Any, folder: str) -> None:
    """Point a link to a chapter to its page; remove the target of a link to a file, which a wheel lacks."""
    href = str(token.attrGet("href"))
    parts = urlsplit(href)
    if parts.scheme or parts.netloc:
        token.attrSet("rel", "noreferrer")
        return
    if not parts.path:
        return
    chapter = BY_FILE.get(posixpath.normpath(posixpath.join(folder, parts.path)))
    if chapter is None:
        del token.attrs["href"]
        return
    token.attrSet("href", f"/help/{chapter.name}" + (f"#{parts.fragment}" if parts.fragment else ""))


def _has_all(text: str, words: Sequence[str]) -> bool:
    folded = text.casefold()
    return all(word in folded for word in words)


def _excerpt(section: HelpSection, words: Sequence[str]) -> str:
    text = " ".join(section.text.split())
    at = max(text.casefold().find(words[0]), 0)
    start = max(at - AROUND, 0)
    return f"{'…' if start else ''}{text[start : at + AROUND]}{'…' if at + AROUND < len(text) else ''}"
