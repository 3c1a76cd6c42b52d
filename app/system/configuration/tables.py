"""The tables of the file that the browser can change, with their keys; others are changed by hand."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import date
from typing import Any, Literal, NamedTuple, get_args

from app.core.web.shape import parse_integer
from app.errors import or_404
from app.line.alarms.settings import OwnValue
from app.line.conditions.catalogue import BUS_ALARMS, SERVER_ALARMS, UNIT_ALARMS
from app.line.conditions.condition import AlarmPriority
from app.records.notification.settings import (
    DAYS,
    MailSecurity,
    NotifiedPriority,
    NotifySettings,
    SmtpSettings,
)
from app.system.configuration.document import TomlValue, at
from bus.configuration import KeyPath
from bus.messages import Message

FieldKind = Literal["text", "number", "flag", "choice", "choices", "texts", "band", "day"]
TableKind = Literal[
    "unit", "alarm", "built_in_alarm", "notify", "smtp", "group", "duty", "rule", "maintenance"
]
MAX_LISTED = 200
"""The most items of a list that is typed as a text."""


class SettingField(NamedTuple):
    """A key of a table, dotted; ``choices``: the texts that it may have."""

    key: str
    kind: FieldKind = "text"
    choices: tuple[str, ...] = ()


class TableForm(NamedTuple):
    """A kind of table: its path, with ``0`` for the index in an array, and its keys. The ``identity``
    distinguishes an element of an array from the others, the ``title`` names it for people; ``is_listed``: it
    is added and removed here."""

    kind: TableKind
    path: KeyPath
    fields: tuple[SettingField, ...]
    title: tuple[str, ...] = ()
    identity: tuple[str, ...] = ()
    is_listed: bool = True


class TablePlace(NamedTuple):
    """A table of the file: its form and its path."""

    form: TableForm
    path: KeyPath

    @property
    def name(self) -> str:
        """The name of the table in addresses, such as ``bus.0.unit.1``."""
        return ".".join(map(str, self.path))


ALARM_CODES = (*UNIT_ALARMS, *BUS_ALARMS, *SERVER_ALARMS)
_INPUTS = ("run", "estop", "preset", "reverse", "up", "down", "slave")
_UNIT = (
    SettingField("name"),
    SettingField("group"),
    SettingField("draw_percent", "band"),
    *(SettingField(f"labels.{key}") for key in ("unit", "analog", "analog_unit")),
    *(SettingField(f"labels.output.{number}") for number in range(1, 7)),
    *(SettingField(f"labels.input.{name}") for name in _INPUTS),
)
_DELAYS = (SettingField("on_delay_s", "number"), SettingField("off_delay_s", "number"))
_ALARM = (
    *(SettingField("name"), SettingField("bus"), SettingField("unit", "number")),
    SettingField("value", "choice", get_args(OwnValue)),
    *(SettingField(key, "number") for key in ("above", "below", "deadband", "change_per_s")),
    SettingField("state", "choice", ("", "on", "off")),
    *_DELAYS,
    SettingField("realarm_s", "number"),
    SettingField("priority", "choice", ("", *get_args(AlarmPriority))),
    SettingField("latch", "flag"),
    *(SettingField(key) for key in ("cause", "consequence", "response")),
)
_BUILT_IN = (
    SettingField("code", "choice", ALARM_CODES),
    *(SettingField("bus"), SettingField("unit", "number")),
    *(SettingField(key, "number") for key in ("above_percent", "below_percent", "deadband_percent")),
    *_DELAYS,
)
_OF_BUILT_IN = ("code", "bus", "unit")
_TO = SettingField("to", "texts")
_PRIORITIES = SettingField("priorities", "choices", get_args(NotifiedPriority))
_DUTY = (
    SettingField("days", "choices", DAYS),
    *(SettingField("starts"), SettingField("ends")),
)
_NOTIFY = (
    *(SettingField("dashboard_url"), SettingField("heartbeat_at")),
    *(SettingField("flood", "number"), SettingField("digest_s", "number")),
)
_SMTP = (
    *(SettingField("host"), SettingField("port", "number")),
    SettingField("security", "choice", ("", *get_args(MailSecurity))),
    *(SettingField("sender"), SettingField("user"), _TO),
    _PRIORITIES,
)
_RULE = (
    SettingField("group"),
    _PRIORITIES,
    SettingField("buses", "texts"),
    SettingField("after_s", "number"),
)
_MAINTENANCE = (
    *_DUTY,
    *(SettingField("until", "day"), SettingField("reason"), SettingField("buses", "texts")),
)
FORMS = (
    TableForm("unit", ("bus", 0, "unit", 0), _UNIT, ("id", "name"), ("id",), is_listed=False),
    TableForm("alarm", ("alarm", 0), _ALARM, ("bus", "unit", "name"), ("bus", "name")),
    TableForm("built_in_alarm", ("built_in_alarm", 0), _BUILT_IN, _OF_BUILT_IN, _OF_BUILT_IN),
    TableForm("notify", ("notify",), _NOTIFY, is_listed=False),
    TableForm("smtp", ("notify", "smtp"), _SMTP, is_listed=False),
    TableForm("group", ("notify", "group", 0), (SettingField("name"), _TO), ("name",), ("name",)),
    TableForm("duty", ("notify", "group", 0, "duty", 0), (*_DUTY, _TO), ("days", "starts", "ends", "to")),
    TableForm("rule", ("notify", "rule", 0), _RULE, ("group", "priorities", "after_s")),
    TableForm(
        "maintenance", ("notify", "maintenance", 0), _MAINTENANCE, ("reason", "days", "starts", "ends")
    ),
)
"""Tables of secrets, such as a webhook, and tables that decide whether the server can be reached are not
among the forms."""


def place_of(name: str, data: Any) -> TablePlace | None:
    """Return the table of a name, or one that may be added there; None for any other name."""
    steps = (parse_integer(step, 4) if step.isdecimal() else step for step in name.split("."))
    path = tuple(step for step in steps if step is not None)
    pattern = tuple(0 if isinstance(step, int) else step for step in path)
    form = next((form for form in FORMS if form.path == pattern), None)
    if form is None:
        return None
    last = path[-1]
    array = at(data, path[:-1]) if isinstance(last, int) else None
    known = len(array) if isinstance(array, list) else 0
    is_there = not isinstance(last, int) or last < known
    is_new = form.is_listed and last == known and (len(path) <= 3 or at(data, path[:-2]) is not None)
    return TablePlace(form, path) if is_there or is_new else None


def place_or_404(name: str, data: Any) -> TablePlace:
    """Return the table of a name, or one that may be added there. Raise Problem 404."""
    message = Message.of("configuration_no_table", name=name[:80])
    return or_404(place_of(name, data), "not_found", message)


def places_of(data: Any) -> Iterator[TablePlace]:
    """Yield every table of the file that is changed here, by kind and in the order of the file."""
    for form in FORMS:
        for path in _paths(data, form.path):
            yield TablePlace(form, path)


def _paths(data: Any, pattern: KeyPath, before: KeyPath = ()) -> Iterator[KeyPath]:
    if len(before) == len(pattern):
        yield before
    elif isinstance(pattern[len(before)], int):
        array = at(data, before)
        for index in range(len(array) if isinstance(array, list) else 0):
            yield from _paths(data, pattern, (*before, index))
    else:
        yield from _paths(data, pattern, (*before, pattern[len(before)]))


def title_of(place: TablePlace, data: Any) -> str:
    """Return the text that names a table for people; empty if there is no table."""
    table = at(data, place.path)
    above = at(data, (*place.path[:-2], "name")) if len(place.path) > 3 else None
    texts = (above, *(at(table, (key,)) for key in place.form.title))
    return " · ".join(text for text in map(text_of, texts) if text)


def end_of(form: TableForm, data: Any, above: KeyPath = ()) -> TablePlace:
    """Return the place where the next table of an array is added; ``above``: the enclosing element."""
    path = (*above, *form.path[len(above) : -1])
    array = at(data, path)
    return TablePlace(form, (*path, len(array) if isinstance(array, list) else 0))


def same_table(place: TablePlace, before: Any, now: Any) -> TablePlace | None:
    """Return the place of the table after others changed the file; None if it cannot be found."""
    table, index = at(before, place.path), place.path[-1]
    if not isinstance(index, int):
        return place
    array = at(now, place.path[:-1])
    if table is None:
        return end_of(place.form, now, place.path[:-2])
    keys = place.form.identity or tuple(table)
    same = [
        number
        for number, each in enumerate(array if isinstance(array, list) else ())
        if all(at(each, (key,)) == table.get(key) for key in keys)
    ]
    return place._replace(path=(*place.path[:-1], same[0])) if len(same) == 1 else None


def texts_of(place: TablePlace, data: Any) -> dict[str, str]:
    """Return the keys of a table as texts of a form, empty if not set."""
    return {field.key: text_of(at(data, (*place.path, *field.key.split(".")))) for field in place.form.fields}


def changes_of(place: TablePlace, data: Any, texts: Mapping[str, str]) -> dict[str, TomlValue | None]:
    """Return the changes of a form: each key whose text differs from the file's, with its value."""
    present = texts_of(place, data)
    return {
        field.key: _value(field, texts[field.key].strip())
        for field in place.form.fields
        if field.key in texts and texts[field.key].strip() != present[field.key]
    }


def text_of(value: Any) -> str:
    """Return a value as text of a form; empty for None."""
    if isinstance(value, bool):
        return "true" if value else ""
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return "" if value is None else value.isoformat() if isinstance(value, date) else str(value)


DEFAULTS: Mapping[str, Mapping[str, str]] = {
    kind: {
        key: text_of(list(field.default) if isinstance(field.default, tuple) else field.default)
        for key, field in settings.model_fields.items()
        if not field.is_required()
    }
    for kind, settings in (("notify", NotifySettings), ("smtp", SmtpSettings))
}
"""The values that hold without a key in the file, as texts of a form, for tables that exist once."""


def _value(field: SettingField, text: str) -> TomlValue | None:
    """Return the value of a typed text; if it does not fit its kind, the text, which is then refused."""
    if not text:
        return None
    match field.kind:
        case "flag":
            return text == "true"
        case "number":
            return _number(text)
        case "day":
            with suppress(ValueError):
                return date.fromisoformat(text)
        case "band":
            return [_number(item) for item in text.split(", ") if item]
        case "choices" | "texts":
            return [item for item in re.split(r"[,;\s]+", text, maxsplit=MAX_LISTED) if item]
    return text


def _number(text: str) -> TomlValue:
    if re.fullmatch(r"-?(0|[1-9]\d{0,17})", text):
        return int(text)
    return float(text) if re.fullmatch(r"-?\d{1,9}\.\d{1,9}", text) else text
