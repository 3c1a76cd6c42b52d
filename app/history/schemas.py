"""Members of the API's responses about history, for its OpenAPI document."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field
from typing_extensions import TypedDict

from app.history.query import Resolution
from app.web.api.schema import problems
from app.web.api.shape import Instant, MessageShown

Column = Annotated[list[float | None], Field(description="In display units; null: a gap.")]
TimeList = Annotated[
    list[Instant | float], Field(description="ISO 8601 in UTC, or with format=epoch seconds since 1970.")
]

HistorySeries = TypedDict(
    "HistorySeries",
    {
        "bus": str,
        "unit": Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")],
        "value": Annotated[str, Field(description="Its name, such as actual or output.1.")],
        "measure": Annotated[str, Field(description="Unit of measurement; empty: none is configured.")],
        "decimals": Annotated[int | None, Field(description="Of the newest point; null: not known.")],
        "from": Annotated[Instant, Field(description="Start of the span, ISO 8601 in UTC.")],
        "to": Annotated[Instant, Field(description="End of the span, ISO 8601 in UTC.")],
        "resolution": Resolution,
        "bucket_s": Annotated[float, Field(description="Seconds that a point stands for; 0: one reading.")],
        "t": TimeList,
        "min": Column,
        "max": Column,
        "avg": Column,
    },
)


class Sparkline(TypedDict):
    """The columns of a sparkline."""

    t: TimeList
    avg: Column


class HistoryMarkText(TypedDict, total=False):
    """The texts of a mark in the reader's language."""

    what: str
    old: str
    new: str


class HistoryMark(TypedDict):
    """One event to be drawn into a chart."""

    t: Annotated[
        Instant | float, Field(description="ISO 8601 in UTC, or with format=epoch seconds since 1970.")
    ]
    until: Annotated[
        Instant | float | None,
        Field(description="Of readings that came late, which are those from t on: their end; else null."),
    ]
    id: Annotated[int, Field(description="Number of the event.")]
    kind: str
    what: str
    who: str
    bus: str | None
    unit: Annotated[int | None, Field(description="Address of the unit (#17), 1 to 255.")]
    old: str | None
    new: str | None
    outcome: str | None
    messages: Annotated[
        dict[str, MessageShown],
        Field(description="what, old and new as data, by field; empty: older."),
    ]
    shown: HistoryMarkText


class HistoryMarks(TypedDict):
    """Events of a span, oldest first."""

    marks: list[HistoryMark]
    more: Annotated[bool, Field(description="Whether there are more than the newest 500.")]


def json_of(model: Any) -> dict[int | str, dict[str, Any]]:
    """For ``responses=`` of an endpoint that writes its JSON itself."""
    return {200: {"model": model, "description": "Successful Response"}, **problems(404)}


EXPORT: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {
            "text/csv": {"schema": {"type": "string"}},
            "application/vnd.apache.parquet": {"schema": {"type": "string", "format": "binary"}},
        }
    },
    **problems(404, 501),
}
"""The response of an export."""
