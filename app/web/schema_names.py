"""The names of schemas and operations in the OpenAPI document: generated clients are written against them.

They are published, so they stay when the code's own names change; ``tests/app/openapi_names.txt`` lists them.
"""

from __future__ import annotations

from typing import Any

SCHEMAS = {
    "AlarmDetailShown": "AlarmDetail",
    "AlarmGroupShown": "AlarmGroup",
    "AlarmJournalShown": "AlarmJournal",
    "AlarmPerformanceShown": "AlarmPerformance",
    "AlarmPriorityShown": "AlarmPriority",
    "AlarmShown": "Alarm",
    "AlarmSimulationBody": "AlarmSimulationRequest",
    "AlarmSimulationShown": "AlarmSimulation",
    "AlarmStateShown": "AlarmState",
    "AlarmTransitionShown": "AlarmTransition",
    "AlarmTriggerShown": "AlarmTrigger",
    "AlarmsShown": "Alarms",
    "AnalogOutputBody": "AnalogOutputRequest",
    "BaudBody": "BaudRequest",
    "BlockBody": "CommandBlockRequest",
    "BlockShown": "CommandBlock",
    "Body": "CommandRequest",
    "BusFiguresShown": "BusStatistics",
    "BusShown": "Bus",
    "CauseShown": "Cause",
    "ComparedShown": "ParameterDifference",
    "ControlShown": "Control",
    "DeliveriesShown": "NotificationDeliveries",
    "DeliveryShown": "NotificationDelivery",
    "DeliveryStateShown": "NotificationDeliveryState",
    "DepartedShown": "RecipeDeparture",
    "DepartureShown": "DriftRow",
    "DriftShown": "Drift",
    "DryRunShown": "RecipeDryRun",
    "DryRunStepShown": "RecipeDryRunStep",
    "EndpointBody": "NotificationTestRequest",
    "EndpointKindShown": "NotificationEndpointKind",
    "EventFrameShown": "EventFrame",
    "EventShown": "Event",
    "CommentBody": "AlarmCommentRequest",
    "ConsequenceShown": "AlarmConsequence",
    "CommandResultShown": "CommandResult",
    "FigureCodeShown": "AlarmFigureCode",
    "FigureShown": "AlarmFigure",
    "FrameShown": "Frame",
    "FrequentAlarmShown": "FrequentAlarm",
    "GoldenMark": "GoldenSetRequest",
    "GoldenShown": "GoldenSet",
    "HandOverBody": "HandOverRequest",
    "InputsShown": "Inputs",
    "LabelsShown": "Labels",
    "LeftAsideShown": "OwnAlarmLeftAside",
    "LeftOutShown": "RestoreOmission",
    "LimitsBody": "SpeedLimits",
    "LineShown": "Line",
    "LoadRecipe": "LoadRecipeRequest",
    "LoadedShown": "LoadedRecipe",
    "MaintenanceBody": "MaintenanceRequest",
    "MaintenanceShown": "Maintenance",
    "MarkShown": "HistoryMark",
    "MarkTextShown": "HistoryMarkText",
    "MarksShown": "HistoryMarks",
    "MessageShown": "Message",
    "MeShown": "CurrentUser",
    "NakShown": "NakCount",
    "NoticeKindShown": "NotificationKind",
    "NotificationEndpointShown": "NotificationEndpoint",
    "NotificationGroupShown": "NotificationGroup",
    "NotificationShown": "Notification",
    "OutOfServiceBody": "AlarmOutOfServiceRequest",
    "OutcomeShown": "Outcome",
    "OutputBody": "OutputRequest",
    "OverdueShown": "OverdueSave",
    "OwnAlarmBody": "OwnAlarmRequest",
    "OwnAlarmChangeBody": "OwnAlarmChangeRequest",
    "OwnAlarmShown": "OwnAlarm",
    "OwnAlarmsShown": "OwnAlarms",
    "ParameterBody": "ParameterRequest",
    "OccurrenceShown": "AlarmOccurrence",
    "OccurrenceTextShown": "AlarmOccurrenceText",
    "OccurrencesShown": "AlarmOccurrences",
    "ParameterShown": "Parameter",
    "PlanRestore": "RestoreRequest",
    "RationalizationShown": "AlarmRationalization",
    "RecipeSetpointShown": "RecipeSetpoint",
    "RecipeShown": "Recipe",
    "RestoreRowShown": "RestoreRow",
    "RestoreShown": "Restore",
    "SaveRecipe": "SaveRecipeRequest",
    "ScheduleShown": "SaveSchedule",
    "SeriesShown": "HistorySeries",
    "SetParameterShown": "ParameterSetParameter",
    "SetShown": "ParameterSet",
    "SetUnitShown": "ParameterSetUnit",
    "SetpointRangeShown": "SetpointRange",
    "SetpointsBody": "SpeedsRequest",
    "ShelveBody": "AlarmShelveRequest",
    "ShiftEventsShown": "ShiftEvents",
    "ShiftNoteBody": "ShiftNoteRequest",
    "ShiftNoteShown": "ShiftNote",
    "SheetAndSignaturesShown": "ShiftSheet",
    "ShiftSheetShown": "SignedShiftSheet",
    "ShiftSignBody": "ShiftSignRequest",
    "ShiftSummaryShown": "ShiftSummary",
    "ShiftsShown": "Shifts",
    "SignatureShown": "ShiftSignature",
    "SignedShown": "ShiftSignatures",
    "SparkShown": "Sparkline",
    "SpeedBody": "SpeedRequest",
    "StartRestore": "StartRestoreRequest",
    "StatusShown": "HistoryStatus",
    "SummaryShown": "ParameterSetSummary",
    "TakeSet": "SaveSetRequest",
    "TestedShown": "NotificationTest",
    "TimeToRespondShown": "AlarmTimeToRespond",
    "TraceShown": "Trace",
    "UnshelveBody": "AlarmReturnRequest",
    "UnitResultShown": "UnitResult",
    "UnitFiguresShown": "UnitStatistics",
    "UnitShown": "Unit",
}
"""Published name of a schema by the name of its class, where they differ."""

OPERATIONS = {
    "block": "block_commands",
    "compare_sets": "compare_parameter_sets",
    "events_as_csv": "export_events",
    "execute": "execute_speed",
    "execute_all": "execute_all_speeds",
    "get_block": "get_command_block",
    "get_export": "export_history",
    "get_figures": "get_bus_statistics",
    "get_limits": "get_speed_limits",
    "get_marks": "get_history_marks",
    "get_series": "get_history_series",
    "get_sparks": "get_sparklines",
    "get_status": "get_history_status",
    "lift_block": "unblock_commands",
    "list_sets": "list_parameter_sets",
    "loaded_recipe": "get_loaded_recipe",
    "mark_golden": "mark_golden_set",
    "me": "get_current_user",
    "one_recipe": "get_recipe",
    "one_restore": "get_restore",
    "one_set": "get_parameter_set",
    "plan_unit_restore": "plan_restore",
    "prove_events": "verify_audit_log",
    "put_limits": "set_speed_limits",
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


def with_published_names(document: dict[str, Any]) -> dict[str, Any]:
    """The document with every schema under its published name. Raises ValueError where two would have one."""
    schemas = document["components"]["schemas"]
    named = {SCHEMAS.get(name, name): schema for name, schema in schemas.items()}
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
        name = reference.removeprefix(_REF)
        renamed["$ref"] = _REF + SCHEMAS.get(name, name)
    if isinstance(title, str):
        renamed["title"] = SCHEMAS.get(title, title)
    return renamed
