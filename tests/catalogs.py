"""What the catalogs of app/core/messages must contain. ``python -m tests.catalogs`` adds what is missing and
removes what is no longer used.
"""

from __future__ import annotations

import ast
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import get_args

from babel.messages.catalog import Catalog
from babel.messages.pofile import read_po, write_po
from jinja2 import Environment, nodes

from app.core.messages.languages import DEFAULT, catalogs
from app.core.web.access import Role, Via
from app.core.web.assets import templates_dir
from app.engineering.sets.model import SetOrigin
from app.engineering.sets.restore_plan import RestoreState
from app.line.commands.catalogue import BAUD_DANGER
from app.line.commands.record import CommandOrigin
from app.line.conditions.catalogue import CONDITIONS
from app.line.history.series.values import VALUES
from app.line.live.fields import STAGE_WORDS, STATE_WORDS, STOPPED_WITH_RUN, TURNING
from app.people.audit.entry import EventKind
from app.records.handover.signatures import SignedPart
from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.values import parameter_unit
from bus.contract import BusLinkState, Outcome, UnitLinkState
from bus.errors import UnitErrorCode, unit_error_name
from bus.messages import TEXTS, Plural

APP = Path(__file__).resolve().parent.parent / "app"
BUS = APP.parent / "bus"
REFUSED = ("blocked", "confirm_needed", "controlled", "dangerous", "late", "moved", "rights_withdrawn")
"""The codes of the refusals that stand where an outcome does."""
Key = tuple[str | None, str]
"""The code of a message, or None for a text of a page; the text in English."""


@cache
def in_templates() -> set[str | tuple[str, str]]:
    """The texts of ``t("…")`` and the pairs of ``tn("…", "…")`` in the templates."""
    found: set[str | tuple[str, str]] = set()
    for path in templates_dir().rglob("*.html"):
        for call in Environment().parse(path.read_text(encoding="utf-8")).find_all(nodes.Call):
            match call:
                case nodes.Call(node=nodes.Name(name="t"), args=[text, *_]):
                    found |= _template_texts(text)
                case nodes.Call(
                    node=nodes.Name(name="tn"),
                    args=[nodes.Const(value=str(one)), nodes.Const(value=str(many)), *_],
                ):
                    found.add((one, many))
    return found


def _template_texts(node: nodes.Node) -> set[str]:
    """The texts that an expression of a template can be, as far as it names them."""
    match node:
        case nodes.Const(value=str(text)):
            return {text} - {""}
        case nodes.CondExpr(expr1=one, expr2=other) | nodes.Or(left=one, right=other):
            return _template_texts(one) | (_template_texts(other) if other else set())
        case nodes.Getitem(node=nodes.Dict(items=pairs)):
            return {text for pair in pairs for text in _template_texts(pair.value)}
    return set()


@cache
def in_code() -> set[str | tuple[str, str]]:
    """The same in the modules of the app and of the worker, and the words of ``term("…")``."""
    found: set[str | tuple[str, str]] = set()
    for path in (each for folder in (APP, BUS) for each in folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(
                    func=ast.Attribute(attr="tn") | ast.Name(id="tn"),
                    args=[ast.Constant(value=str(one)), ast.Constant(value=str(many)), *_],
                ):
                    found.add((one, many))
                case ast.Call(func=ast.Attribute(attr="t") | ast.Name(id="t" | "term"), args=[text, *_]):
                    found |= _code_texts(text)
    return found


def _code_texts(node: ast.expr) -> set[str]:
    match node:
        case ast.Constant(value=str(text)):
            return {text} - {""}
        case ast.IfExp(body=one, orelse=other):
            return _code_texts(one) | _code_texts(other)
    return set()


def in_tables() -> set[str]:
    """The words of tables that pages look up."""
    parameters = PARAMETERS.values()
    return {
        *STATE_WORDS.values(),
        STOPPED_WITH_RUN,
        TURNING,
        *STAGE_WORDS.values(),
        *(unit_error_name(code) for code in UnitErrorCode),
        *(parameter.name for parameter in parameters),
        *(parameter.meaning for parameter in parameters),
        *(parameter.group for parameter in parameters),
        *(parameter.dangerous for parameter in parameters if parameter.dangerous),
        *(word for parameter in parameters for word in parameter.choices.values()),
        *(unit for parameter in parameters if (unit := parameter_unit(parameter))),
        *get_args(SetOrigin),
        *get_args(SignedPart),
        *get_args(RestoreState),
        *(str(role) for role in Role),
        *(kind.replace("_", " ") for kind in get_args(EventKind)),
        *get_args(Outcome),
        *get_args(CommandOrigin),
        *get_args(Via),
        *get_args(BusLinkState),
        *get_args(UnitLinkState),
        *REFUSED,
        BAUD_DANGER,
        *(row.means for row in CONDITIONS.values() if row.means),
        *(value.words for value in VALUES.values()),
    }


@cache
def wanted() -> dict[Key, str | tuple[str, str]]:
    """Everything that a catalog must hold."""
    texts = in_templates() | in_code() | in_tables()
    pairs = {text[0]: text for text in texts if isinstance(text, tuple)}
    found: dict[Key, str | tuple[str, str]] = {(None, text): text for text in texts if isinstance(text, str)}
    found |= {(None, one): pair for one, pair in pairs.items()}
    for code, text in TEXTS.items():
        found[code, text.one if isinstance(text, Plural) else text] = (
            tuple(text) if isinstance(text, Plural) else text
        )
    return found


def catalog_at(path: Path) -> Catalog:
    """A catalog as it is stored."""
    return read_po(BytesIO(path.read_bytes()), locale=path.stem)


def key_of(message: object) -> Key:
    """Which of the wanted texts an entry translates."""
    text = message.id[0] if isinstance(message.id, tuple) else message.id  # type: ignore[attr-defined]
    return message.context, text  # type: ignore[attr-defined]


def write(path: Path, catalog: Catalog) -> None:
    """Store a catalog, sorted, one text a line."""
    target = BytesIO()
    write_po(target, catalog, width=0, sort_output=True, omit_header=False, ignore_obsolete=True)
    path.write_bytes(target.getvalue())


def leftovers(path: Path) -> list[Key]:
    """Return the entries of a catalog that are not used."""
    return [key for message in catalog_at(path) if message.id and (key := key_of(message)) not in wanted()]


def bring_up_to_date(path: Path) -> None:
    """Add what is missing to the catalog, untranslated, and remove what is not used."""
    catalog = catalog_at(path)
    there = {key_of(message): message for message in catalog if message.id}
    for key in leftovers(path):
        message = there[key]
        catalog.delete(message.id, message.context)
    for (code, _), text in wanted().items():
        if (code, _) not in there:
            catalog.add(text, context=code)
    write(path, catalog)


if __name__ == "__main__":
    for tag, each in catalogs().items():
        if tag != DEFAULT:
            bring_up_to_date(each)
