"""The color tokens in print and with forced colors."""

from __future__ import annotations

import re

from app.core.web.assets import static_dir

TOKENS = (static_dir() / "css" / "tokens.css").read_text(encoding="utf-8")
PRINT = (static_dir() / "css" / "print.css").read_text(encoding="utf-8")
SYSTEM = re.compile(r"\b(Canvas|CanvasText|ButtonText|ButtonFace|Highlight|HighlightText|Mark|MarkText)\b")
WITHOUT_PAINT = {"--shadow"}
WIDTHS = re.compile(r"^@media [^{]*\bwidth\b[^{]*\{.*?^\}", re.MULTILINE | re.DOTALL)
PAINT = re.compile(r"^ *((?:[\w-]*color|background[\w-]*|opacity|filter|mix-blend-mode):.*)", re.MULTILINE)
RULE = re.compile(r"^([^@{}\s][^{}]*) \{\n([^{}]*)\}", re.MULTILINE)
"""A rule outside of others: its selector, and what it declares."""
PANEL_REM = 80
"""The width of a panel, 1280 px."""


def declared(css: str) -> dict[str, str]:
    return dict(re.findall(r"(--[\w-]+): ([^;]+);", css))


def test_each_colour_gives_way_to_a_persons_own() -> None:
    usual, _, forced = TOKENS.partition("@media (forced-colors: active)")
    colours = {name for name, value in declared(usual).items() if re.search(r"#|rgb\(", value)}
    given = declared(forced)
    assert len(colours) > 20
    assert colours - WITHOUT_PAINT - given.keys() == set()
    assert [name for name, value in given.items() if not SYSTEM.search(value)] == []


def test_paper_is_light_also_where_the_dark_theme_was_chosen() -> None:
    chosen = re.findall(r"^(:root\S*) \{\n  color-scheme: dark", TOKENS, re.MULTILINE)
    printed = re.findall(r"^  (:root\S*) \{\n    color-scheme: light", PRINT, re.MULTILINE)
    assert (chosen, printed) == ([':root[data-theme="dark"]'], [":root:root"]), (
        "the later of equal weight holds"
    )


def test_no_style_of_a_window_wider_than_a_panel_changes_a_color() -> None:
    """For this reason the browser tests judge the contrast up to that width."""
    wider = [
        block
        for sheet in (static_dir() / "css").rglob("*.css")
        for block in WIDTHS.findall(sheet.read_text(encoding="utf-8"))
        if any(float(rem) > PANEL_REM for rem in re.findall(r"([\d.]+)rem", block.partition("{")[0]))
    ]
    assert len(wider) >= 2
    assert [painted for block in wider for painted in PAINT.findall(block)] == []


def test_no_style_swallows_the_next() -> None:
    """A rule without its closing brace is valid: what follows is nested in it."""
    sheets = {path.name: path.read_text(encoding="utf-8") for path in (static_dir() / "css").rglob("*.css")}
    assert [name for name, css in sheets.items() if css.count("{") != css.count("}")] == []


def test_a_sheet_looks_the_same_on_its_page_and_in_its_file() -> None:
    """What both have in common is stated once, and each has it."""
    folder = static_dir() / "css"
    common, *own = (folder / name for name in ("sheet.css", "handover.css", "handover-document.css"))
    rules = set(RULE.findall(common.read_text(encoding="utf-8")))
    assert len(rules) >= 7
    for path in own:
        css = path.read_text(encoding="utf-8")
        assert '@import "sheet.css";' in css
        assert not rules & set(RULE.findall(css)), path
