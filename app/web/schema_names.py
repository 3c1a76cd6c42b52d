"""The names of schemas and operations in the OpenAPI document: generated clients are written against them.

They are published, so they stay when the code's own names change; ``tests/app/openapi_names.txt`` lists them.
"""

from __future__ import annotations

from typing import Any

SCHEMAS = {
    "BlockBody": "CommandBlockRequest",
    "BlockShown": "CommandBlock",
    "Body": "CommandRequest",
    "BusFiguresShown": "BusStatistics",
    "ComparedShown": "ParameterDifference",
    "DeliveriesShown": "NotificationDeliveries",
    "DeliveryShown": "NotificationDelivery",
    "DeliveryStateShown": "NotificationDeliveryState",
    "DepartedShown": "RecipeDeparture",
    "DepartureShown": "DriftRow",
    "DryRunShown": "RecipeDryRun",
    "DryRunStepShown": "RecipeDryRunStep",
    "EndpointBody": "NotificationTestRequest",
    "EndpointKindShown": "NotificationEndpointKind",
    "CommentBody": "AlarmCommentRequest",
    "ConsequenceShown": "AlarmConsequence",
    "FigureCodeShown": "AlarmFigureCode",
    "FigureShown": "AlarmFigure",
    "GoldenMark": "GoldenSetRequest",
    "GoldenShown": "GoldenSet",
    "LeftAsideShown": "OwnAlarmLeftAside",
    "LeftOutShown": "RestoreOmission",
    "LimitsBody": "SpeedLimits",
    "LoadRecipe": "LoadRecipeRequest",
    "LoadedShown": "LoadedRecipe",
    "MarkShown": "HistoryMark",
    "MarkTextShown": "HistoryMarkText",
    "MarksShown": "HistoryMarks",
    "MeShown": "CurrentUser",
    "NakShown": "NakCount",
    "NoticeKindShown": "NotificationKind",
    "OutOfServiceBody": "AlarmOutOfServiceRequest",
    "OverdueShown": "OverdueSave",
    "OccurrenceShown": "AlarmOccurrence",
    "OccurrenceTextShown": "AlarmOccurrenceText",
    "OccurrencesShown": "AlarmOccurrences",
    "PlanRestore": "RestoreRequest",
    "RationalizationShown": "AlarmRationalization",
    "SaveRecipe": "SaveRecipeRequest",
    "ScheduleShown": "SaveSchedule",
    "SeriesShown": "HistorySeries",
    "SetParameterShown": "ParameterSetParameter",
    "SetShown": "ParameterSet",
    "SetUnitShown": "ParameterSetUnit",
    "SetpointsBody": "SpeedsRequest",
    "ShelveBody": "AlarmShelveRequest",
    "SheetAndSignaturesShown": "ShiftSheet",
    "ShiftSheetShown": "SignedShiftSheet",
    "SignatureShown": "ShiftSignature",
    "SignedShown": "ShiftSignatures",
    "SparkShown": "Sparkline",
    "StartRestore": "StartRestoreRequest",
    "StatusShown": "HistoryStatus",
    "SummaryShown": "ParameterSetSummary",
    "TakeSet": "SaveSetRequest",
    "TestedShown": "NotificationTest",
    "TimeToRespondShown": "AlarmTimeToRespond",
    "UnshelveBody": "AlarmReturnRequest",
    "UnitFiguresShown": "UnitStatistics",
}
"""Published name of a schema by the name of its class, where :func:`schema_name` would give another."""

OPERATIONS = {
    "compare_sets": "compare_parameter_sets",
    "events_as_csv": "export_events",
    "get_export": "export_history",
    "get_marks": "get_history_marks",
    "get_series": "get_history_series",
    "get_sparks": "get_sparklines",
    "get_status": "get_history_status",
    "list_sets": "list_parameter_sets",
    "loaded_recipe": "get_loaded_recipe",
    "mark_golden": "mark_golden_set",
    "one_recipe": "get_recipe",
    "one_restore": "get_restore",
    "one_set": "get_parameter_set",
    "plan_unit_restore": "plan_restore",
    "prove_events": "verify_audit_log",
    "read_schedule": "get_save_schedule",
    "retire_recipe": "delete_recipe",
    "set_document": "export_parameter_set",
    "take_set": "save_parameter_set",
    "try_recipe": "dry_run_recipe",
    "unit_drift": "get_drift",
    "write_schedule": "set_save_schedule",
}
"""Published ``operationId`` by the name of the endpoint's function, where they differ."""

_REF = "#/components/schemas/"


def operation_name(function: str) -> str:
    return OPERATIONS.get(function, function)


def schema_name(model: str) -> str:
    """``AlarmShown`` → ``Alarm``, ``BaudBody`` → ``BaudRequest``, but for those in :data:`SCHEMAS`."""
    usual = f"{model.removesuffix('Body')}Request" if model.endswith("Body") else model.removesuffix("Shown")
    return SCHEMAS.get(model, usual)


def with_published_names(document: dict[str, Any]) -> dict[str, Any]:
    """The document with every schema under its published name. Raises ValueError where two would have one."""
    schemas = document["components"]["schemas"]
    named = {schema_name(name): schema for name, schema in schemas.items()}
    if len(named) < len(schemas):
        raise ValueError("two schemas have one published name; see app/web/schema_names.py")
    document["components"]["schemas"] = named
    renamed: dict[str, Any] = _renamed(document)
    return renamed


def _portable(schema: dict[str, Any]) -> dict[str, Any]:
    """Of a dictionary with a pattern for its keys, client generators understand the values only this way."""
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
