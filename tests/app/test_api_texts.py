"""No text of the API comes without the code and the params that it was rendered from."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from app.core.web.api import openapi_document
from app.main import create_app
from tests.app.complete_app import settings_in

AS_DATA = {
    "Alarm.message": "alarm_message",
    "Cause.detail": "code",
    "CommandResult.detail": "reason",
    "Event.message": "messages",
    "Event.new": "messages",
    "Event.old": "messages",
    "Event.what": "messages",
    "Event.who": "messages",
    "Event.origin": "messages",
    "EventFrame.meaning": "meanings",
    "Frame.meaning": "meanings",
    "HistoryMark.new": "messages",
    "HistoryMark.old": "messages",
    "HistoryMark.what": "messages",
    "InvalidField.detail": "code",
    "Message.detail": "code",
    "Problem.detail": "reason",
    "UnitResult.detail": "reason",
}
"""By text: the field that has it as data, where that is not called ``…_message``."""
OF_A_NUMBER = {
    "NakCount.unit_error_name": "unit_error",
    "CommandResult.unit_error_name": "unit_error",
    "Problem.unit_error_name": "unit_error",
    "Problem.title": "status",
    "UnitResult.unit_error_name": "unit_error",
    "Parameter.dangerous": "number",
    "Parameter.group": "number",
    "Parameter.meaning": "number",
    "Parameter.value": "raw",
    "ParameterSetParameter.value": "raw",
}
"""A fixed text of a number that stands beside it."""
CODES = {
    *("FrequentAlarm.alarm", "AlarmOccurrence.alarm"),
    *("cause_code", "code", "direction", "effect", "evidence", "kind", "mode", "outcome", "resolution"),
    "AlarmSimulation.toml",
    *("CommandResult.reason", "Problem.reason", "UnitResult.reason"),
    *("HistoryStatus.put_aside", "ShiftNote.alarm", "ShiftNote.pictures", "time_zone"),
    *("ShiftSignatures.digest", "ShiftSignatures.page_digest"),
    *("AlarmTransition.alarm", "ReportedAlarm.alarm", "ReportedAlarm.at_end", "ShiftAlarm.alarm"),
    *("LineCause.motion", "LinesOfSites.version", "LinesOfSites.instance"),
    *("ParameterSet.origin", "ParameterSetSummary.origin", "state", "type", "where"),
    *(
        "NotificationDelivery.alarms",
        "NotificationDelivery.endpoint",
        "NotificationEndpoint.key",
        "message_id",
    ),
    *("Configuration.digest", "ConfigurationVersion.digest", "Configuration.file"),
    *("ConfigurationTable.name", "ConfigurationTable.values", "DifferenceLine.text"),
}
TYPED_BY_PEOPLE = {
    *("analog", "analog_unit", "bus", "comment", "group", "id", "input", "measure", "name", "output", "port"),
    *("CommandBlock.reason", "site", "unit", "who", "by", "changed_by", "holder"),
    *("Alarm.hidden_by", "Alarm.reason"),
    *("LineOfSite.peer", "LineOfSite.url", "LineOfSite.place", "PeerOfSite.url"),
    *("AlarmTransition.reason", "ReportedAlarm.reason", "ShiftAlarm.reason"),
    *("MissingSignature.reason", "ShiftSignature.reason"),
    *(f"OwnAlarm.{name}" for name in ("cause", "consequence", "response")),
    *("ShiftNote.text", "Maintenance.reason", "NotificationEndpoint.address", "on_duty"),
    *("ConfigurationVersion.reason", "length_unit", "ReportedUnit.speed_unit"),
    *("ReadOnly.reason", "RecurringMaintenance.buses", "RecurringMaintenance.reason"),
}
IN_THE_READERS_LANGUAGE = {
    *(f"HistoryMarkText.{name}" for name in ("what", "old", "new")),
    "AlarmOccurrenceText.place",
}
"""The messages of the mark, rendered."""
REQUESTS = {"Quantity"}
TIMES = {
    *("acknowledged_at", "at", "changed_at", "from", "lapses_at", "link_since", "loaded_at", "proven_at"),
    *("read_at", "saved_at", "sent_at", "since", "t", "taken_at", "time", "to"),
    *(
        "shelved_until",
        "unknown_since",
        "Alarm.came",
        "Alarm.cleared",
        "ShiftAlarm.came",
        "RecipeRuns.loaded",
        "RecipeRuns.before",
    ),
    *("created_at", "end", "made_at", "start", "tried_at", "until", "written_at", "Shifts.next"),
    *("HistoryStatus.begun", "HistoryStatus.oldest_reading"),
    *(f"RecurringMaintenance.{name}" for name in ("starts", "ends", "last_day")),
    *(
        "covered_from",
        "covered_to",
        "AlarmSimulation.first",
        "AlarmSimulation.last",
    ),
}
NUMBERS_AND_BYTES = {
    *("actual", "commanded", "data", "deviation", "draw", "frame", "frames", "hex", "highest", "lowest"),
    *(f"OwnAlarm.{name}" for name in ("above", "below", "deadband", "change_per_s")),
    *(
        "recipe",
        "staged",
        "Unit.implausible",
        "HistorySeries.value",
        "RecipeDryRunStep.new",
        "RecipeSetpoint.value",
    ),
}
NO_TEXT = CODES | IN_THE_READERS_LANGUAGE | TYPED_BY_PEOPLE | TIMES | NUMBERS_AND_BYTES


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return openapi_document(create_app(settings_in(tmp_path_factory.mktemp("texts"))))


@pytest.fixture(scope="module")
def schemas(document: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = document["components"]["schemas"]
    return found


def holds_text(schema: Any) -> bool:
    """Whether a value may be a text that no list of the description names."""
    if "enum" in schema or "const" in schema or "$ref" in schema:
        return False
    kinds = schema.get("type", [])
    if "string" in ([kinds] if isinstance(kinds, str) else kinds):
        return True
    inner = [*schema.get("anyOf", []), *schema.get("items", {}).get("anyOf", [])]
    return any(holds_text(each) for each in [*inner, schema.get("items", {})] if each)


def texts(schemas: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for name, schema in schemas.items():
        for field, described in schema.get("properties", {}).items():
            if name not in REQUESTS and not name.endswith("Request") and holds_text(described):
                yield f"{name}.{field}", field, schema["properties"]


def test_every_text_has_its_code(schemas: dict[str, Any]) -> None:
    without = [
        place
        for place, field, fields in texts(schemas)
        if (AS_DATA | OF_A_NUMBER).get(place, f"{field}_message") not in fields
        and not {field, place} & NO_TEXT
    ]
    assert not without, without


def test_every_text_that_is_named_is_there(schemas: dict[str, Any]) -> None:
    there = {place for place, _, _ in texts(schemas)}
    assert sorted((AS_DATA.keys() | OF_A_NUMBER.keys()) - there) == []


def test_a_message_is_described_as_one(schemas: dict[str, Any]) -> None:
    assert schemas["Message"]["required"] == ["code", "params", "detail"]
    members = {
        f"{name}.{field}": "schemas/Message'" in str(described)
        for name, schema in schemas.items()
        for field, described in schema.get("properties", {}).items()
    }
    assert sum(members.values()) > 30
    named = [place for place in members if place.endswith(("_message", "_messages"))]
    assert [place for place in named if not members[place]] == []


LOCAL_TIMES = {*(f"RecurringMaintenance.{name}" for name in ("starts", "ends", "last_day")), "time_zone"}
"""Times of the day and days of the site, which are no instants."""
AN_INSTANT = {"type": "string", "format": "date-time"}
NAMED_SO = re.compile(r"(^|_)(at|since|until|from|to|time|start|end|t)$")


def is_instant(described: dict[str, Any]) -> bool:
    """Whether all but null and, on request, numbers of it are instants."""
    kinds = described.get("anyOf") or [described.get("items", described)]
    inner = [kind for each in kinds for kind in each.get("anyOf", [each])]
    return any({**kind, **AN_INSTANT} == kind for kind in inner)


def test_every_time_is_an_instant_in_one_format(schemas: dict[str, Any]) -> None:
    """Some were seconds since 1970, and none of the others had a format."""
    times = {
        f"{name}.{field}": described
        for name, schema in schemas.items()
        for field, described in schema.get("properties", {}).items()
        if (NAMED_SO.search(field) or {field, f"{name}.{field}"} & TIMES)
        and described.get("type") != "boolean"
        and not {field, f"{name}.{field}"} & (LOCAL_TIMES | {"HandOverRequest.to", "ReportedAlarm.at_end"})
    }
    assert len(times) > 60
    assert [place for place, described in times.items() if not is_instant(described)] == []


def test_a_number_for_a_time_comes_on_request_alone(schemas: dict[str, Any]) -> None:
    described = {
        f"{name}.{field}": str(described)
        for name, schema in schemas.items()
        for field, described in schema.get("properties", {}).items()
    }
    with_numbers = {place for place, text in described.items() if "since 1970" in text}
    assert with_numbers == {"HistorySeries.t", "HistoryMark.t", "Sparkline.t"}
    assert all("format=epoch" in described[place] for place in with_numbers)


def test_times_of_a_query_are_instants_and_every_write_may_state_its_own(document: dict[str, Any]) -> None:
    operations = {
        f"{method} {path}": {each["name"]: each for each in operation.get("parameters", ())}
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    }
    times = [
        parameters[name]["schema"]
        for parameters in operations.values()
        for name in ("from", "to", "start")
        if name in parameters
    ]
    assert len(times) > 20
    assert all(is_instant(schema) for schema in times)
    for operation, parameters in operations.items():
        assert ("Lineside-Sent-At" in parameters) == (not operation.startswith("get "))


def test_the_document_names_its_server(document: dict[str, Any]) -> None:
    assert [server["url"] for server in document["servers"]] == ["/"]
