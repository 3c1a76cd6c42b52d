"""A message to people as data: a code and the values of its text, with the English texts. Pure.

The English texts are in the ``texts.toml`` beside the code that uses them.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Sequence
from decimal import Decimal
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol, TypeAlias

import msgspec
from msgspec import Meta


class Plural(NamedTuple):
    """A text with a number of things: ``one`` if the message's ``n`` is 1, else ``many``."""

    one: str
    many: str


EnglishText: TypeAlias = str | Plural
TEXTS: dict[str, EnglishText] = {}
"""The English texts by code: those of the bus, and those of the app if it is imported."""
PARAMETER_NAMES: dict[int, str] = {}
"""The English names of the parameters by number, filled by the catalogue of parameters."""


def add_texts(package: Path) -> None:
    """Add the texts of a package and its subpackages. Raise ValueError for a code that exists already."""
    for path in sorted(package.rglob("texts.toml")):
        with path.open("rb") as file:
            found = tomllib.load(file)
        if twice := found.keys() & TEXTS.keys():
            raise ValueError(f"{path}: {', '.join(sorted(twice))} is also in another texts.toml")
        for code, text in found.items():
            TEXTS[code] = text if isinstance(text, str) else Plural(**text)


add_texts(Path(__file__).parent)


class Catalog(Protocol):
    """The texts of one language."""

    @property
    def point(self) -> str:
        """The decimal sign."""

    def template(self, code: str, n: object) -> str | None:
        """Return the template of a message, with names in braces, for ``n`` things if it has a plural; None
        for an unknown code."""

    def term(self, text: str) -> str:
        """Return a fixed word of the program in this language."""

    def time(self, text: str) -> str:
        """Return a date or a time in ISO 8601 as readers of this language write it."""

    def isolated(self, text: str) -> str:
        """Return a text of a person, such as a name, so that letters written from right to left do not turn
        what is beside it on a screen. A catalog for programs returns it unchanged."""


class EnglishCatalog:
    """The English texts, for the log, the command line and ``detail`` of the API."""

    point = "."

    def template(self, code: str, n: object) -> str | None:
        text = TEXTS.get(code)
        if isinstance(text, Plural):
            return text.one if n == 1 else text.many
        return text

    def term(self, text: str) -> str:
        return text

    def time(self, text: str) -> str:
        return text

    def isolated(self, text: str) -> str:
        return text


ENGLISH = EnglishCatalog()


DEEPEST = 8
"""The most levels of messages inside messages."""
MAX_TEXT = 4_000
"""The most characters of a value, and of a rendered message."""
LARGEST = 50_000
"""The largest size of a message with all that it contains: the characters of its texts, and `VALUE_SIZE` for
each value. A report of 255 units needs half of this."""
VALUE_SIZE = 20
NUMBER = "number"
"""Code of a decimal number: ``value`` is written with a point, and shown with the language's sign."""
TERM = "term"
"""Code of a fixed word of the program: ``text`` is looked up in the catalog unchanged."""
LIST = "list"
"""Code of a list whose messages are joined by commas: ``items``."""
PARAMETER = "parameter"
"""Code of a parameter of a unit, shown by its name with its ``number``. In a template, the brace of this name
stands for the parameter of the message's own ``number``."""
UNIT_NAME = "unit_name"
"""The brace that stands for the message's own ``unit`` or ``units``: names as they are, addresses with the
word for a unit."""
_TIME = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:\d\d)?)?")
"""A date or a time as programs write it."""
_BRACES = re.compile(r"\{(\w+)\}")

MessageCode = Annotated[str, Meta(max_length=60, pattern="^[a-z][a-z0-9_]*$")]
ParamName = Annotated[str, Meta(max_length=40)]
ParamText = Annotated[str, Meta(max_length=MAX_TEXT)]
ParamList = Annotated["list[int | ParamText | Message]", Meta(max_length=500)]
Finite = Annotated[float, Meta(ge=-1e15, le=1e15)]
ParamValue: TypeAlias = "int | Finite | ParamText | Message | ParamList"


class Message(msgspec.Struct, frozen=True):
    """A message: ``code`` names the text, ``params`` are the values of its braces; both are for programs too.

    A text in ``params`` is shown unchanged: it may come from a request, from a person or from another
    process. Only a date or a time in ISO 8601 is written as the language does. A value that has to be
    translated is a message itself. A list is joined: messages by semicolons, other values by commas. Raise
    ValueError if a message is nested too deeply, or too large.
    """

    code: MessageCode
    params: Annotated[dict[ParamName, ParamValue], Meta(max_length=20)] = {}

    @classmethod
    def of(cls, code: str, /, **params: ParamValue | list[Any]) -> Message:
        """Make a message, its params as keywords. Params that nest too deeply, or are too large, become
        English text, because they may come from another process."""
        try:
            return cls(code, params)
        except ValueError:
            return cls(code, {name: shown(value, ENGLISH)[:MAX_TEXT] for name, value in params.items()})

    def __post_init__(self) -> None:
        if self.params:
            _check_bounds(self.params.values())

    def __hash__(self) -> int:
        return hash((self.code, str(self.params)) if self.params else self.code)

    def __str__(self) -> str:
        return self.render(ENGLISH)

    def render(self, catalog: Catalog) -> str:
        """Return the text in the language of ``catalog``, at most 4,000 characters.

        A message may come from another process, so its text is never a format string: that could reach into
        objects (``{a.__class__}``) and pad without bound (``{a:>999999999}``).
        """
        if self.code == NUMBER:
            return str(self.params.get("value", "")).replace(".", catalog.point)
        if self.code == LIST:
            items = self.params.get("items")
            return ", ".join(shown(each, catalog) for each in (items if isinstance(items, list) else []))
        if self.code == TERM:
            return catalog.term(str(self.params.get("text", "")))
        if self.code == PARAMETER:
            return _with_name(self.params.get("number", "")).render(catalog)
        template = catalog.template(self.code, self.params.get("n"))
        if template is None:
            template = " ".join([self.code, *(f"{{{name}}}" for name in self.params)])
        pieces = list(_pieces(template))
        pieces[1::2] = [self._filled(name, catalog) for name in pieces[1::2]]
        return "".join(pieces)[:MAX_TEXT]

    def _filled(self, name: str, catalog: Catalog) -> str:
        value = self.params.get(name)
        if value is None and name == PARAMETER and "number" in self.params:
            value = Message(PARAMETER, {"number": self.params["number"]})
        if value is None and name == UNIT_NAME:
            value = self._unit_named()
        return f"{{{name}}}" if value is None else shown(value, catalog)

    def _unit_named(self) -> ParamValue | None:
        if (unit := self.params.get("unit", self.params.get("units"))) is None:
            return None
        addresses = unit if isinstance(unit, list) else [unit]
        is_named = any(isinstance(each, str) for each in addresses)
        return unit if is_named else Message("unit_address", {"unit": unit})


@lru_cache(512)
def _pieces(template: str) -> tuple[str, ...]:
    """Split a template into an alternating sequence of texts and the names of its braces."""
    return tuple(_BRACES.split(template))


def in_english(message: Message | None) -> str:
    """Return the text of a message in English; empty for None."""
    return "" if message is None else str(message)


def joined(messages: Iterable[Message | None]) -> Message | None:
    """Join several messages to one, without those that are None; None if nothing is left."""
    several = [each for each in messages if each is not None]
    if len(several) > 1:
        return Message.of("several", messages=several)
    return several[0] if several else None


def number(value: Decimal | str) -> Message:
    """Return a decimal number as a message; each language writes it with its own decimal sign."""
    return Message(NUMBER, {"value": str(value)})


def term(text: str) -> Message:
    """Return a fixed word of the program as the value of another message."""
    return Message(TERM, {"text": text})


def parameter_name(number: int) -> Message:
    """Return the name of a parameter with its number, as the value of another message."""
    return Message(PARAMETER, {"number": number})


def _with_name(number: ParamValue) -> Message:
    """Return the name of a parameter, even for an unknown number from another process."""
    if not isinstance(number, int) or (name := PARAMETER_NAMES.get(number)) is None:
        return Message.of("parameter_not_listed", number=number)
    return Message("parameter_named", {"name": term(name), "number": number})


def listed(items: Sequence[int | str | Message]) -> Message:
    """Return several values as the value of another message, joined by commas."""
    return Message.of(LIST, items=list(items))


def shown(value: ParamValue, catalog: Catalog) -> str:
    """Return a param as it appears in the text of its message."""
    match value:
        case int():  # the most frequent
            return str(value)
        case Message():
            return value.render(catalog)
        case str():
            return catalog.time(value) if _TIME.fullmatch(value) else catalog.isolated(value)
        case list():
            separator = "; " if any(isinstance(each, Message) for each in value) else ", "
            # A question ends its own sentence.
            return separator.join(shown(each, catalog) for each in value).replace("?; ", "? ")
        case float():
            return str(value).replace(".", catalog.point)
        case _:
            return str(value)


def _check_bounds(values: Iterable[object]) -> None:
    """Check the bounds of a message. Raise ValueError if its ``values`` hold more than `DEEPEST` levels of
    messages, or more than `LARGEST` together: the state of every unit keeps one."""
    size, waiting = 0, [(values, 0)]
    while waiting:
        level, depth = waiting.pop()
        for value in level:
            size += VALUE_SIZE
            if isinstance(value, int):  # the most frequent
                continue
            if isinstance(value, str):
                size += len(value)
            elif isinstance(value, list):
                waiting.append((value, depth))
            elif isinstance(value, Message):
                if depth == DEEPEST:
                    raise ValueError(f"messages are nested more than {DEEPEST} deep")
                if value.params:
                    waiting.append((value.params.values(), depth + 1))
        if size > LARGEST:
            raise ValueError(f"a message is larger than {LARGEST}")
