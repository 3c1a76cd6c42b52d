"""The configuration for programs: the same tables, checks and versions as on the pages."""

from __future__ import annotations

import asyncio
import tomllib
from collections.abc import Mapping
from datetime import date
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path
from pydantic import Field
from typing_extensions import TypedDict

from app.core.web.access import Engineer, Person
from app.core.web.api import ApiRoute
from app.core.web.services import service
from app.core.web.shape import MessageObject, StrictBody
from app.errors import Problem
from app.people.audit.acts import Act
from app.system.configuration.document import (
    ConfigurationVersion,
    DifferenceLine,
    Edit,
    at,
    difference,
    moved_up,
    with_values,
    without,
)
from app.system.configuration.service import (
    CHANGE,
    CHANGE_MAIL,
    RESTART,
    ROLL_BACK,
    ConfigurationFile,
    Restart,
)
from app.system.configuration.tables import (
    TableKind,
    TablePlace,
    changes_of,
    place_or_404,
    places_of,
    text_of,
)
from bus.messages import Message
from bus.validation import OneLine


def act_on(place: TablePlace) -> Act:
    """Return the act that a person must be permitted."""
    return CHANGE_MAIL if place.form.kind in ("notify", "smtp") else CHANGE


def edit_of(place: TablePlace, kind: str, texts: Mapping[str, str]) -> Edit:
    """Return the edit of a request by its ``kind``: ``change`` sets keys to typed values, ``remove`` removes
    the table, ``up`` exchanges it with the table before it. Raise Problem 422 for an edit that does not fit
    the table."""
    if kind == "change":
        return lambda text: _changed(text, place, texts)
    if kind == "remove" and place.form.is_listed:
        return lambda text: without(text, place.path)
    if kind == "up" and place.form.kind == "unit":
        return lambda text: moved_up(text, place.path)
    raise Problem(422, "invalid", Message.of("configuration_no_such_change", name=place.name))


def _changed(text: str, place: TablePlace, texts: Mapping[str, str]) -> str:
    changes = changes_of(place, tomllib.loads(text), texts)
    return with_values(text, place.path, changes) if changes else text


router = APIRouter(prefix="/api/v1/configuration", tags=["configuration"], route_class=ApiRoute)

FileOfServer = Annotated[ConfigurationFile, service(ConfigurationFile)]
RestartOfServer = Annotated[Restart, service(Restart)]
ConfigurationChanger = Annotated[Person, CHANGE.permitted]
SetValue = str | bool | int | float | list[str | int | float]
TableName = Annotated[str, Path(max_length=80, description="Keys and indexes, such as bus.0.unit.1.")]
FileDigest = Annotated[str, Field(max_length=64, description="Of the file that the change began from.")]
MAX_REASON = 200
VersionNumber = Annotated[int, Path(ge=1, le=2**31, description="Number of a version.")]


class ConfigurationTable(TypedDict):
    """A table of the file that can be changed here; ``values``: the keys that are set, dotted."""

    name: str
    kind: TableKind
    values: Annotated[dict[str, SetValue], Field(description="In the units of the file.")]


class ConfigurationShown(TypedDict):
    """The configuration file. ``running``: whether the server runs with it; else it takes effect at the next
    start. ``faults``: why the server would not start with it."""

    file: str
    digest: str
    writable: bool
    running: bool
    waiting: Annotated[
        list[DifferenceLine], Field(description="Lines that take effect at the next start; secrets masked.")
    ]
    faults: list[MessageObject]
    tables: list[ConfigurationTable]


class ConfigurationVersions(TypedDict):
    """The versions that are kept, newest first."""

    versions: list[ConfigurationVersion]
    next: None


class ConfigurationSince(TypedDict):
    """A version, and the difference of the present file from it."""

    version: ConfigurationVersion
    difference: list[DifferenceLine]


class ConfigurationChange(TypedDict):
    """The change that was written, or (``review``) would be; ``version``: null for a review."""

    version: ConfigurationVersion | None
    difference: list[DifferenceLine]


class RestartRequest(StrictBody):
    """A restart with the text of the file that has this digest, and no other."""

    digest: FileDigest
    reason: Annotated[OneLine, Field(max_length=MAX_REASON, description="Why, for the audit log.")] = ""


class ConfigurationRollBackRequest(RestartRequest):
    """A way back to a version. ``review``: nothing is written."""

    review: bool = False


class ConfigurationChangeRequest(ConfigurationRollBackRequest):
    """A change of a table. ``values``: keys to set, dotted, such as ``labels.output.1``; null removes a key.
    ``act``: remove the table instead, or exchange a unit with the one before it."""

    act: Literal["change", "remove", "up"] = "change"
    values: Annotated[dict[str, SetValue | None], Field(max_length=60, default_factory=dict)]


@router.get("")
async def get_configuration(_: Engineer, file: FileOfServer) -> ConfigurationShown:
    """List the tables of the file that can be changed here."""
    present = await file.present()
    return {
        "file": str(file.path),
        "digest": present.digest,
        "writable": present.is_writable,
        "running": present.is_running,
        "waiting": await asyncio.to_thread(file.waiting, present),
        "faults": list(present.faults),
        "tables": [_table_shown(place, present.data) for place in places_of(present.data)],
    }


@router.put("/tables/{table_name}")
async def change_configuration(
    person: ConfigurationChanger, file: FileOfServer, table_name: TableName, body: ConfigurationChangeRequest
) -> ConfigurationChange:
    """Change a table. A name with the index after the last one adds a table."""
    place = place_or_404(table_name, (await file.present()).data)
    known = [field.key for field in place.form.fields]
    for key in body.values:
        if key not in known:
            message = Message.of("configuration_no_key", key=key[:80], known=", ".join(known))
            raise Problem(422, "invalid", message)
    texts = {key: text_of(value) for key, value in body.values.items()}
    return await _done(person, file, act_on(place), edit_of(place, body.act, texts), body)


@router.get("/versions")
async def get_configuration_versions(_: Engineer, file: FileOfServer) -> ConfigurationVersions:
    """List the versions of the file, with author and time."""
    return {"versions": await file.versions(), "next": None}


@router.get("/versions/{version_number}")
async def get_configuration_version(
    _: Engineer, file: FileOfServer, version_number: VersionNumber
) -> ConfigurationSince:
    """Return a version, and the difference of the present file from it. Secrets are masked."""
    stored, present = await file.version(version_number), await file.present()
    return {"version": stored.version, "difference": difference(stored.text, present.text)}


@router.post("/versions/{version_number}/roll-back")
async def roll_back_configuration(
    person: Annotated[Person, ROLL_BACK.permitted],
    file: FileOfServer,
    version_number: VersionNumber,
    body: ConfigurationRollBackRequest,
) -> ConfigurationChange:
    """Write the text of a version as a new version."""
    stored = await file.version(version_number)
    return await _done(person, file, ROLL_BACK, lambda _: stored.text, body)


@router.post("/restart", status_code=204)
async def restart_server(
    person: Annotated[Person, RESTART.permitted], restart: RestartOfServer, body: RestartRequest
) -> None:
    """Restart the server with the present file. The drives keep their speed; for a few seconds they are
    neither monitored nor commanded."""
    await restart.request(person, body.digest, body.reason)


async def _done(
    person: Person, file: ConfigurationFile, act: Act, edit: Edit, body: ConfigurationRollBackRequest
) -> ConfigurationChange:
    act.check(person)
    review = await file.review(edit, body.digest)
    if body.review:
        file.refuse_faults(review)
        return {"version": None, "difference": review.lines}
    saved = await file.save(person, act, edit, body.digest, body.reason)
    return {"version": saved, "difference": review.lines}


def _table_shown(place: TablePlace, data: Any) -> ConfigurationTable:
    found = ((field.key, at(data, (*place.path, *field.key.split(".")))) for field in place.form.fields)
    values = {key: each.isoformat() if isinstance(each, date) else each for key, each in found}
    return {
        "name": place.name,
        "kind": place.form.kind,
        "values": {key: value for key, value in values.items() if value is not None},
    }
