"""The OpenAPI document: names, descriptions and examples, and each text with its code."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from jsonschema_rs import Draft202012Validator

from app.core.database import Database
from app.core.help.feature import calls_of, in_html
from app.core.web.api import add_examples, openapi_document, with_published_names
from app.main import create_app
from bus.contract import Outcome, UnitOutcome
from tests.app.complete_app import House, settings_in
from tests.app.fake_worker import PlayedWorker, responding
from tests.app.strict_schema import strict
from tests.for_each import for_each


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    app = create_app(settings_in(Path(tmp_path_factory.mktemp("document"))))
    try:
        return openapi_document(app)
    finally:
        app.state.services[Database].close()


def test_every_operation_has_a_name_a_tag_and_a_summary(document: dict[str, Any]) -> None:
    names = []
    for methods in document["paths"].values():
        for operation in methods.values():
            names.append(operation["operationId"])
            assert re.fullmatch(r"[a-z]+(_[a-z]+)+", operation["operationId"])
            assert len(operation["tags"]) == 1
            assert operation["summary"]
    assert len(names) == len(set(names)) > 80


def test_every_request_and_response_has_an_example_of_its_schema(document: dict[str, Any]) -> None:
    components = strict(document["components"])
    count = 0
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            contents = [operation.get("requestBody", {}).get("content", {})]
            success = next(each for status, each in operation["responses"].items() if status[0] == "2")
            contents.append(success.get("content", {}))
            for content in (each for media_types in contents for each in media_types.values()):
                schema = {**content["schema"], "components": components}
                faults = [str(each) for each in Draft202012Validator(schema).iter_errors(content["example"])]
                assert faults == [], f"{method} {path}"
                count += 1
    assert count > 100


def test_the_reference_for_people_shows_each_example(document: dict[str, Any]) -> None:
    calls = [call for _, group in calls_of(document) for call in group]
    assert [call.id for call in calls if call.body and not call.sent] == []
    without = [call for call in calls if not call.received]
    assert [call.id for call in without if "204" not in dict(call.responses)] == []


def test_the_reference_for_people_shows_code_without_its_backquotes(document: dict[str, Any]) -> None:
    calls = [call for _, group in calls_of(document) for call in group]
    words = [call.words for call in calls]
    words += [each.words for call in calls for each in (*call.parameters, *call.body)]
    words += [each for call in calls for _, each in call.responses]
    assert len([each for each in words if "<code>" in each]) > 20
    assert [each for each in words if "`" in each] == []
    assert in_html("``a < b``, `id` & more") == "<code>a &lt; b</code>, <code>id</code> &amp; more"


def test_a_missing_example_leaves_the_document_without_it() -> None:
    unknown = {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/Unknown"}}}}
    anything: dict[str, Any] = {"content": {"application/json": {"schema": {}}}}
    responses = {"200": anything, "404": {"description": "None"}}
    operation = {"requestBody": unknown, "responses": responses}
    add_examples({"components": {"schemas": {}}, "paths": {"/": {"post": operation}}})
    assert "example" not in unknown["content"]["application/json"]
    assert anything["content"]["application/json"]["example"] is None


NAMES = Path(__file__).parent / "openapi_names.txt"


def references(node: Any) -> Iterator[str]:
    """Every ``$ref`` of a document."""
    if isinstance(node, dict):
        yield from (value for key, value in node.items() if key == "$ref" and isinstance(value, str))
    for each in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from references(each)


def test_every_reference_leads_to_something(document: dict[str, Any]) -> None:
    found = set(references(document))
    assert {"#/components/headers/Retry-After", "#/components/schemas/Problem"} <= found
    for reference in found:
        node = document
        for step in reference.removeprefix("#/").split("/"):
            assert step in node, reference
            node = node[step]


def test_a_tried_request_does_not_state_an_old_time(document: dict[str, Any]) -> None:
    """Tools send the example of a header along, and a write of long ago is refused."""
    sent_at = [
        parameter
        for methods in document["paths"].values()
        for operation in methods.values()
        for parameter in operation.get("parameters", ())
        if parameter["name"] == "Lineside-Sent-At"
    ]
    assert len(sent_at) > 40
    assert all("example" not in str(parameter) for parameter in sent_at)


def test_the_names_that_clients_are_written_against_stay(document: dict[str, Any]) -> None:
    """A name may be added to the list; one that is taken away or changed breaks the programs of users."""
    operations = [
        f"{operation['operationId']} {method.upper()} {path}"
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    ]
    schemas = [f"schema {name}" for name in document["components"]["schemas"]]
    assert sorted(operations) + sorted(schemas) == NAMES.read_text(encoding="utf-8").splitlines()


def is_typed(schema: dict[str, Any]) -> bool:
    """Whether a generated client has a type for it: anything at all and any object are none."""
    match schema:
        case {"$ref": _}:
            return True
        case {"type": "array", "items": items}:
            return is_typed(items)
        case {"type": "object"}:
            values = schema.get("additionalProperties")
            return "properties" in schema or (isinstance(values, dict) and is_typed(values))
        case {"anyOf": choices}:
            return all(is_typed(choice) for choice in choices)
    return "type" in schema


def test_every_operation_describes_its_responses(document: dict[str, Any]) -> None:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            where = f"{method} {path}"
            assert operation["description"], where
            responses = operation["responses"]
            success = [reply for status, reply in responses.items() if status.startswith("2")]
            assert len(success) == 1, where
            for content in success[0].get("content", {}).values():
                assert is_typed(content["schema"]), where
            problems = {status for status in responses if not status.startswith("2")}
            assert problems >= {"401", "403", "422", "503", "default"}, where
            assert all("application/problem+json" in responses[status]["content"] for status in problems), (
                where
            )


def test_every_parameter_is_described(document: dict[str, Any]) -> None:
    undescribed = [
        f"{path} {parameter['name']}"
        for path, methods in document["paths"].items()
        for operation in methods.values()
        for parameter in operation.get("parameters", ())
        if not parameter.get("description")
    ]
    assert undescribed == []


def test_numbers_in_responses_have_their_unit_or_range(document: dict[str, Any]) -> None:
    """An id, and what counts or speaks for itself, needs none."""
    plain = {"id", "set", "version", "size_bytes", "count", "entries", "next", "status"}
    undescribed = [
        f"{name}.{field}"
        for name, schema in document["components"]["schemas"].items()
        if not name.endswith("Request")
        for field, value in schema.get("properties", {}).items()
        if "number" in json.dumps(value.get("anyOf", [value]))
        or "integer" in json.dumps(value.get("anyOf", [value]))
        if not value.get("description") and field not in plain
    ]
    assert undescribed == []


def test_two_schemas_of_one_name_are_refused() -> None:
    schemas: dict[str, Any] = {"SpeedShown": {}, "Speed": {}}
    with pytest.raises(ValueError, match="one published name"):
        with_published_names({"components": {"schemas": schemas}})


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
        "ReportedAlarm.again_at",
        "RecipeRuns.loaded",
        "RecipeRuns.before",
    ),
    *("created_at", "end", "made_at", "start", "tried_at", "until", "written_at", "Shifts.next"),
    *("HistoryStatus.begun", "HistoryStatus.oldest_reading"),
    *(f"RecurringMaintenance.{name}" for name in ("starts", "ends", "last_day")),
    *("covered_from", "covered_to", "AlarmSimulation.first", "AlarmSimulation.last"),
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


@for_each(
    ("outcome", "status"), [("verified", 200), ("refused", 409), ("unverified", 504), ("bus_closed", 503)]
)
async def test_the_result_of_a_command_is_as_described(
    document: dict[str, Any], site: House, worker: PlayedWorker, outcome: Outcome, status: int
) -> None:
    worker.play = responding(outcome, read_back=250, units=[UnitOutcome(1, outcome, unit_error=128)])
    path, schema = "/units/1/speed", {"components": strict(document["components"])}
    response = await site.request("POST", path, {"raw": 250})
    assert response.status_code == status
    described = document["paths"]["/api/v1/buses/{bus}/units/{unit}/speed"]["post"]["responses"]
    (content,) = described[str(status)]["content"].values()
    assert [*Draft202012Validator(schema | content["schema"]).iter_errors(response.json())] == []


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
