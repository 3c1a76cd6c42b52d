"""Every operation has a name, a tag, a summary, and examples that are as it describes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from jsonschema_rs import Draft202012Validator

from app.core.database import Database
from app.core.help.feature import calls_of, in_html
from app.core.web.api import add_examples, openapi_document
from app.main import create_app
from tests.app.complete_app import settings_in
from tests.app.strict_schema import strict


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
