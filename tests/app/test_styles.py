"""The color tokens in print and with forced colors."""

from __future__ import annotations

import re

from app.core.web.assets import static_dir

TOKENS = (static_dir() / "css" / "tokens.css").read_text(encoding="utf-8")
SYSTEM = re.compile(r"\b(Canvas|CanvasText|ButtonText|ButtonFace|Highlight|HighlightText|Mark|MarkText)\b")
WITHOUT_PAINT = {"--shadow"}


def declared(css: str) -> dict[str, str]:
    return dict(re.findall(r"(--[\w-]+): ([^;]+);", css))


def test_each_colour_gives_way_to_a_persons_own() -> None:
    usual, _, forced = TOKENS.partition("@media (forced-colors: active)")
    colours = {name for name, value in declared(usual).items() if re.search(r"#|rgb\(", value)}
    given = declared(forced)
    assert len(colours) > 20
    assert colours - WITHOUT_PAINT - given.keys() == set()
    assert [name for name, value in given.items() if not SYSTEM.search(value)] == []


def test_every_text_has_one_of_five_sizes() -> None:
    sizes = {name: value for name, value in declared(TOKENS).items() if name.startswith("--t-")}
    assert len(sizes) == 5
    assert min(float(value.removesuffix("rem")) * 16 for value in sizes.values()) >= 14
    used = [
        (path.name, size)
        for path in (static_dir() / "css").rglob("*.css")
        for size in re.findall(r"font-size: ([^;]+);", path.read_text(encoding="utf-8"))
    ]
    named = re.compile(r"var\(--(t-(sm|md|lg|xl|2xl)|verdict|cause)\)")
    # Of size 0 is a word that another one, or a mark, stands for, and that is still read aloud.
    relative = re.compile(r"0|inherit|[\d.]+(em|pt)( !important)?")
    assert len(used) > 100
    assert [each for each in used if not named.search(each[1]) and not relative.fullmatch(each[1])] == []
