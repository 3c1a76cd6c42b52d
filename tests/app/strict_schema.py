"""A schema as a strict program reads it."""

from __future__ import annotations

from typing import Any


def strict(node: Any) -> Any:
    """The schema, refusing members that it does not name."""
    if isinstance(node, list):
        return [strict(each) for each in node]
    if not isinstance(node, dict):
        return node
    made = {name: strict(each) for name, each in node.items()}
    return {"additionalProperties": False, **made} if isinstance(made.get("properties"), dict) else made
