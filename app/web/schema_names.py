"""The names of schemas in the OpenAPI document are those of their classes: clients are generated from them.

They are published, so such a class is not renamed; ``tests/app/openapi_names.txt`` lists them and the
operations, which have the names of their functions.
"""

from __future__ import annotations

from typing import Any

_REF = "#/components/schemas/"


def schema_name(model: str) -> str:
    """The name of the class, without the ending that it has where a class of the domain has that name:
    ``AlarmShown`` → ``Alarm``, ``CommandRequestBody`` → ``CommandRequest``."""
    return model.removesuffix("Shown").removesuffix("Body")


def with_published_names(document: dict[str, Any]) -> dict[str, Any]:
    """The document with every schema under its published name. Raises ValueError where two would have one."""
    schemas = document["components"]["schemas"]
    named = {schema_name(name): schema for name, schema in schemas.items()}
    if len(named) < len(schemas):
        raise ValueError("two schemas have one published name; rename one class")
    document["components"]["schemas"] = named
    renamed: dict[str, Any] = _renamed(document)
    return renamed


def _portable(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema of a dictionary with a pattern for its keys, in the form that generators understand."""
    patterns = schema.get("patternProperties", {})
    if len(patterns) != 1:
        return schema
    ((pattern, values),) = patterns.items()
    rest = {key: value for key, value in schema.items() if key != "patternProperties"}
    return {**rest, "propertyNames": {"pattern": pattern}, "additionalProperties": values}


def _renamed(node: Any) -> Any:
    if isinstance(node, list):
        return [_renamed(each) for each in node]
    if not isinstance(node, dict):
        return node
    renamed = {key: _renamed(value) for key, value in _portable(node).items()}
    reference, title = renamed.get("$ref"), renamed.get("title")
    if isinstance(reference, str):
        renamed["$ref"] = _REF + schema_name(reference.removeprefix(_REF))
    if isinstance(title, str):
        renamed["title"] = schema_name(title)
    return renamed
