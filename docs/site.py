"""``make docs``: the handbook as HTML files that need no server, from the chapters that the dashboard shows.

``python -m docs.site FOLDER`` writes a page for each chapter and language, the pictures, and an index.
"""

from __future__ import annotations

import re
import shutil
import sys
from html import escape
from pathlib import Path

from app.core.help.handbook import CHAPTERS, ENGLISH, Chapter, Handbook, Rendered
from app.core.web.assets import docs_dir, static_dir

LINK = re.compile(r'(href|src)="/help/(pictures/)?([\w/-]+)(\.png)?')
STYLES = ("lineside.css", "pages/help.css")


def main(folder: Path) -> None:
    """Write the site into a folder, in place of what was there of it."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(docs_dir() / "pictures", folder / "pictures", ignore=shutil.ignore_patterns("all"))
    shutil.copytree(static_dir() / "css", folder / "css")
    handbook, listed = Handbook(docs_dir()), []
    for chapter in CHAPTERS:
        for language in (ENGLISH, *chapter.languages):
            rendered = handbook.chapter(chapter, language)
            name = file_of(chapter, language)
            (folder / name).write_text(page(rendered, language), encoding="utf-8")
            listed.append(f'<li lang="{language}"><a href="{name}">{escape(rendered.title)}</a></li>')
    contents = f"<h1>Lineside</h1><ul>{''.join(listed)}</ul>"
    (folder / "index.html").write_text(document("Lineside", ENGLISH, contents), encoding="utf-8")


def file_of(chapter: Chapter, language: str) -> str:
    """The file of a chapter: ``operator.html``, in German ``operator.de.html``."""
    return f"{chapter.name}{'' if language == ENGLISH else f'.{language}'}.html"


def page(rendered: Rendered, language: str) -> str:
    """A chapter as a document whose links lead to files beside it."""
    beside = LINK.sub(
        lambda found: f'{found[1]}="{found[2] or ""}{found[3]}{found[4] or ".html"}', rendered.html
    )
    return document(rendered.title, language, f'<p><a href="index.html">Lineside</a></p>{beside}')


def document(title: str, language: str, body: str) -> str:
    styles = "".join(f'<link rel="stylesheet" href="css/{name}">' for name in STYLES)
    return (
        f'<!doctype html><html lang="{language}"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width"><title>{escape(title)}</title>{styles}</head>'
        f'<body><main class="main help">{body}</main></body></html>\n'
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
