"""The catalogs are complete: every text of the screen and every message, with the same names in braces."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from app.core.messages import Languages
from app.core.messages.languages import DEFAULT, FOLDER, catalogs, compiled
from app.line.conditions.catalogue import CONDITIONS
from bus.messages import (
    PARAMETER,
    TEXTS,
    UNIT_NAME,
    Message,
    Plural,
    add_texts,
    listed,
    number,
    parameter_name,
    term,
)
from hatch_build import different_names
from tests.catalogs import catalog_at, in_code, in_templates, key_of, leftovers, wanted
from tests.for_each import for_each

ROOT = Path(__file__).resolve().parents[3]
TRANSLATED = {tag: path for tag, path in catalogs().items() if tag != DEFAULT}
FORMER_EVENTS = ROOT / "app" / "people" / "audit" / "former_events" / "texts.toml"
BRACES = re.compile(r"\{(\w*)\}")
BARE_NUMBER = re.compile(r"(?<!&)#(\d|\{)")
MANY = re.compile(r"\{n\} (units|rows|addresses|values|parameters|followers|sets|events|frames|readings)\b")


def each_text(text: str | tuple[str, ...] | list[str]) -> list[str]:
    return [text] if isinstance(text, str) else list(text)


@pytest.mark.parametrize("path", TRANSLATED.values(), ids=TRANSLATED)
def test_every_text_is_translated(path: Path) -> None:
    there = {key_of(message) for message in catalog_at(path) if message.id and all(each_text(message.string))}
    assert sorted(wanted().keys() - there, key=str) == []


@pytest.mark.parametrize("path", catalogs().values(), ids=catalogs())
def test_nothing_is_left_over(path: Path) -> None:
    assert leftovers(path) == []


def test_a_translation_has_the_names_of_its_text() -> None:
    assert different_names(FOLDER) == []


def test_a_translation_with_other_names_is_not_built(tmp_path: Path) -> None:
    text, translation = "{n} of {m}", "{n} von allen"
    header = f'msgid ""\nmsgstr "Content-Type: text/plain; charset=utf-8\\n"\n\nmsgid "{text}"\nmsgstr '
    (tmp_path / "de.po").write_text(f'{header}"{translation}"\n')
    assert different_names(tmp_path) == [f"de.po: {text}"]
    (tmp_path / "de.po").write_text(f'{header}""\n')
    assert different_names(tmp_path) == []


@pytest.mark.parametrize("path", TRANSLATED.values(), ids=TRANSLATED)
def test_a_plural_has_the_forms_of_its_language(path: Path) -> None:
    catalog = catalog_at(path)
    plurals = [message for message in catalog if isinstance(message.id, tuple | list)]
    assert len(plurals) > 40
    assert [message.id for message in plurals if len(message.string) != catalog.num_plurals] == []


def test_a_code_is_in_one_file_only(tmp_path: Path) -> None:
    before = dict(TEXTS)
    (tmp_path / "texts.toml").write_text('event_mode = "again"\n')
    with pytest.raises(ValueError, match=r"texts\.toml: event_mode is also in another"):
        add_texts(tmp_path)
    assert before == TEXTS


def bare_numbers(texts: Iterable[str]) -> list[str]:
    """Texts with a parameter that is a number alone."""
    return [text for text in texts if BARE_NUMBER.search(text)]


@pytest.mark.parametrize("path", TRANSLATED.values(), ids=TRANSLATED)
def test_a_parameter_has_its_name_in_every_text(path: Path) -> None:
    """The number follows in words; a number alone is a column of a table, beside the name."""
    assert bare_numbers(["set #18", "#{number}", "a ramp (parameter 7)", "&#160;"]) == [
        "set #18",
        "#{number}",
    ]
    english = [each for text in wanted().values() for each in each_text(text)]
    assert bare_numbers(english) == []
    assert bare_numbers(each for message in catalog_at(path) for each in each_text(message.string)) == []


def test_a_parameter_is_named_in_each_language_by_its_number() -> None:
    drift = Message.of("drift", n=1, number=7)
    german = Languages()["de"]
    assert str(drift) == "Deceleration Ramp Rate (parameter 7) differs from the golden set"
    assert german.t(drift) == "Rücklauframpe (Parameter 7) weicht vom Referenzsatz ab"
    assert german.t(listed([parameter_name(6), parameter_name(41)])) == (
        "Hochlauframpe (Parameter 6), Parameter 41 (nicht in der Liste)"
    )


def test_a_text_is_beside_the_code_that_uses_it() -> None:
    """In the folder of a module that makes its message, or above it; those of a condition beside its row."""
    of_rows = {code for row in CONDITIONS.values() for code in row.texts}
    wrong = []
    for path in (*(ROOT / "app").rglob("texts.toml"), *(ROOT / "bus").rglob("texts.toml")):
        below = [module for module in modules() if path.parent in module.path.parents]
        made = {code for module in below for code, _ in module.messages}
        named = {each for module in below for each in module.constants}
        if path != FORMER_EVENTS:
            wrong += [
                (path, code) for code in tomllib.loads(path.read_text()).keys() - made - named - of_rows
            ]
    assert wrong == []


def names_of(code: str) -> set[str]:
    text = TEXTS[code]
    if isinstance(text, Plural):
        return {"n", *BRACES.findall(text.one), *BRACES.findall(text.many)}
    return set(BRACES.findall(text))


def filled_by(names: set[str]) -> set[str]:
    """The braces that these params fill: a number also that of the name of its parameter, a unit that of its
    own name."""
    of_parameter = {PARAMETER} if "number" in names else set()
    return names | of_parameter | ({UNIT_NAME} if names & {"unit", "units"} else set())


def codes_of(node: ast.expr) -> set[str]:
    """The codes that an expression can be."""
    match node:
        case ast.Constant(value=str(code)):
            return {code}
        case ast.IfExp(body=body, orelse=other):
            return codes_of(body) | codes_of(other)
        case ast.JoinedStr(values=parts):
            each = [re.escape(str(part.value)) if isinstance(part, ast.Constant) else ".+" for part in parts]
            return {code for code in TEXTS if re.fullmatch("".join(each), code)}
    return set()


def made_in(nodes: Iterable[ast.AST]) -> Iterator[tuple[str, set[str]]]:
    """The messages that a module makes: each with its code and the names of its params."""
    for node in nodes:
        match node:
            case ast.Call(args=[ast.JoinedStr() as code]) if "Message" in ast.unparse(node.func):
                yield from ((each, {"**"}) for each in codes_of(code))
            case ast.Call(
                func=ast.Attribute(value=ast.Name(id="Message"), attr="of"), args=[code], keywords=given
            ):
                yield from ((each, {one.arg or "**" for one in given}) for each in codes_of(code))
            case ast.Call(func=ast.Name(id="Message"), args=[code]):
                yield from ((each, set()) for each in codes_of(code))
            case ast.Call(func=ast.Name(id="Message"), args=[ast.Constant(value=str(code)), ast.Dict(keys)]):
                yield code, {each.value if isinstance(each, ast.Constant) else "**" for each in keys}


@dataclass(frozen=True)
class Module:
    """The messages that a module makes, and every constant in it."""

    path: Path
    messages: list[tuple[str, set[str]]]
    constants: set[object]


@cache
def modules() -> list[Module]:
    """All of both packages."""
    found = []
    for path in sorted((*(ROOT / "app").rglob("*.py"), *(ROOT / "bus").rglob("*.py"))):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        constants = {node.value for node in nodes if isinstance(node, ast.Constant)}
        found.append(Module(path, list(made_in(nodes)), constants))
    return found


def test_each_message_has_a_text_and_its_values() -> None:
    """More values than the text has are for programs."""
    wrong = [
        (module.path, code, names)
        for module in modules()
        for code, names in module.messages
        if code not in TEXTS or ("**" not in names and not filled_by(names) >= names_of(code))
    ]
    assert wrong == []


def test_each_text_is_of_a_message() -> None:
    """Or of an event that an earlier version stored."""
    made = {code for module in modules() for code, _ in module.messages}
    named = {each for module in modules() for each in module.constants}
    former = tomllib.loads(FORMER_EVENTS.read_text("utf-8")).keys()
    assert sorted(TEXTS.keys() - named - made - former) == []
    assert sorted(former & made) == []


def test_a_text_with_a_count_has_a_singular() -> None:
    """A script that counts takes the texts of a ``tn`` from the page."""
    assert "Set line to zero" in in_templates()
    assert ("{n} row differs", "{n} rows differ") in in_templates()
    assert "Staged setpoints" in in_code()
    found = in_templates() | in_code()
    counted = {text for pair in found if isinstance(pair, tuple) for text in pair}
    assert {text for text in found - counted if isinstance(text, str) and MANY.search(text)} == set()


def test_one_file_adds_a_language(tmp_path: Path) -> None:
    header = 'msgid ""\nmsgstr "Content-Type: text/plain; charset=utf-8\\n"\n'
    header += '"Plural-Forms: nplurals=2; plural=(n != 1);\\n"\n'
    (tmp_path / "en.po").write_text(header)
    text = 'msgid "Set {unit} to {value}"\nmsgstr "Still {unit} til {value}"\n'
    plural = 'msgid "{n} row"\nmsgid_plural "{n} rows"\nmsgstr[0] "{n} rad"\nmsgstr[1] "{n} rader"\n'
    coded = 'msgctxt "event_server_started"\nmsgid "server started"\nmsgstr "tjeneren startet"\n'
    (tmp_path / "nb.po").write_text(f"{header}\n{text}\n{plural}\n{coded}")
    norwegian = Languages(tmp_path).choose("", "nb-NO", "en")
    assert norwegian.t("Set {unit} to {value}", unit="Nip", value="1,0") == "Still Nip til 1,0"
    assert norwegian.t(Message("event_server_started")) == "tjeneren startet"
    assert norwegian.t(Message("event_server_ended")) == TEXTS["event_server_ended"]
    assert norwegian.t("not translated yet {x}") == "not translated yet {x}"
    assert [norwegian.tn("{n} row", "{n} rows", n) for n in (1, 2)] == ["1 rad", "2 rader"]
    assert (str(norwegian), norwegian.name) == ("nb", "norsk bokmål")


def test_a_language_has_the_plurals_of_its_file(tmp_path: Path) -> None:
    rule = "nplurals=3; plural=(n==1 ? 0 : n%10>=2 && n%10<=4 && (n%100<10 || n%100>=20) ? 1 : 2);"
    header = f'msgid ""\nmsgstr "Content-Type: text/plain; charset=utf-8\\n"\n"Plural-Forms: {rule}\\n"\n'
    forms = ("{n} wiersz", "{n} wiersze", "{n} wierszy")
    written = "".join(f'msgstr[{index}] "{form}"\n' for index, form in enumerate(forms))
    text = f'\nmsgid "{{n}} row"\nmsgid_plural "{{n}} rows"\n{written}'
    (tmp_path / "pl.po").write_text(header + text)
    polish = Languages(tmp_path)["pl"]
    assert [polish.tn("{n} row", "{n} rows", n) for n in (1, 2, 5, 22)] == [
        *("1 wiersz", "2 wiersze", "5 wierszy", "22 wiersze")
    ]


def test_a_message_is_rendered_in_each_language() -> None:
    english, german = Languages()["en"], Languages()["de"]
    message = Message.of("unit_refused", unit=7, error=Message("illegal_speed"))
    assert english.t(message) == str(message) == "unit 7 rejected the command: illegal speed value"
    assert german.t(message) == "Regler 7 hat den Befehl abgelehnt: unzulässige Geschwindigkeit"
    assert german.t(number("48.0")) == "48,0"
    assert german.t(term("verified")) == "bestätigt (gelesen)"


@for_each(
    ("stored", "english", "german"),
    [
        ("2026-11-26T17:04:05.000+00:00", "26 Nov 2026, 18:04:05", "26.11.2026, 18:04:05"),
        ("2026-11-26T17:04:05Z", "26 Nov 2026, 18:04:05", "26.11.2026, 18:04:05"),
        ("2026-11-26 18:04", "26 Nov 2026, 18:04", "26.11.2026, 18:04"),
        ("2026-11-26", "26 Nov 2026", "26.11.2026"),
        ("2026-13-26", "2026-13-26", "2026-13-26"),
        ("9999-12-31T23:59Z", "9999-12-31T23:59Z", "9999-12-31T23:59Z"),
        ("line-2026-11-26.tar", "line-2026-11-26.tar", "line-2026-11-26.tar"),
    ],
)
def test_a_time_in_a_message_is_by_the_clock_of_the_site_in_the_form_of_the_language(
    stored: str, english: str, german: str
) -> None:
    languages = Languages(time_zone="Europe/Berlin")
    message = Message.of("alarm_active_since", time=stored)
    assert languages["en"].t(message) == f"active since {english}"
    assert languages["de"].t(message) == f"aktiv seit {german}"
    assert str(message) == f"active since {stored}", "programs and the log have one form"


def test_the_texts_of_every_code_are_found_by_it() -> None:
    german = Languages()["de"]
    assert {code for code in TEXTS if german.template(code, 1) is None} == set()


def test_a_compiled_catalog_is_kept_until_its_source_changes(tmp_path: Path) -> None:
    source, kept = tmp_path / "nb.po", tmp_path / "kept"
    header = 'msgid ""\nmsgstr "Content-Type: text/plain; charset=utf-8\\n"\n\n'
    source.write_text(header + 'msgid "open"\nmsgstr "åpen"\n', encoding="utf-8")
    assert compiled(source, kept).gettext("open") == "åpen"
    written = (kept / "nb.mo").stat().st_mtime_ns
    assert compiled(source, kept).gettext("open") == "åpen"
    assert (kept / "nb.mo").stat().st_mtime_ns == written
    source.write_text(header + 'msgid "open"\nmsgstr "åpent"\n', encoding="utf-8")
    assert compiled(source, kept).gettext("open") == "åpent"


def test_a_folder_that_cannot_be_written_costs_nothing(tmp_path: Path) -> None:
    source, file = tmp_path / "nb.po", tmp_path / "file"
    source.write_text('msgid ""\nmsgstr ""\n\nmsgid "open"\nmsgstr "apen"\n')
    file.touch()
    assert compiled(source, file / "in").gettext("open") == "apen"


def german_texts() -> list[tuple[str, str]]:
    """Each German text with its English."""
    messages = [message for message in catalog_at(catalogs()["de"]) if message.id]
    return [(str(message.id), text) for message in messages for text in each_text(message.string)]


def test_a_german_text_requests_in_the_infinitive_and_bedienfeld_is_the_keypad_of_the_drive() -> None:
    assert [text for text in german_texts() if re.search(r"\b\w+en Sie\b", text[1])] == []
    wrong = [text for text in german_texts() if "Bedienfeld" in text[1] and "keypad" not in text[0].lower()]
    assert wrong == []
